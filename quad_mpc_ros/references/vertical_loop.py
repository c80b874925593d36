"""A vertical loop: a full circle in a vertical plane, from rest at its lowest point and back.

The angle is a smooth turn (``references/smooth_turn.py``), so speed, acceleration and jerk are
continuous from hover to hover, and the path stays on the circle. At the top the thrust points
downwards when the centripetal acceleration v^2/r exceeds gravity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.references.path import CircularPath
from quad_mpc_ros.references.smooth_turn import SmoothTurn
from quad_mpc_ros.references.trajectory import TrajectoryParameters

_LEAST_PULL = 1.2  # centripetal acceleration at the top over gravity


@dataclass(frozen=True, kw_only=True)
class VerticalLoopParameters(TrajectoryParameters):
    """Parameters of a vertical loop; a split-S ends with half a loop."""

    loop_radius: float = parameter(
        1.5,
        doc="vertical_loop: radius. split_s: radius of the inverted part.",
        unit="m",
        above=0.0,
        maximum=1e3,
    )
    loop_speed: float = parameter(
        5.5,
        doc="vertical_loop: speed at the highest point.",
        unit="m/s",
        above=0.0,
        maximum=1e3,
    )


def vertical_loop(config: VerticalLoopParameters) -> CircularPath:
    """Return the configured loop, flown forwards in the direction of the nose."""
    radius, speed = config.loop_radius, config.loop_speed
    least = math.sqrt(_LEAST_PULL * config.gravity * radius)
    if speed < least:
        raise ConfigurationError(
            f"{config.owner}.loop_speed",
            speed,
            f"at least {least:.3g} m/s, below which a loop of {radius:g} m radius needs no "
            "thrust at its top",
        )
    return CircularPath(
        np.array([*config.origin, config.height]),
        forwards=np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0]),
        inwards=np.array([0.0, 0.0, 1.0]),
        radius=radius,
        turn=SmoothTurn.with_peak_rate(math.tau, rate=speed / radius),
    )

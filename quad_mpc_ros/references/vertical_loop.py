"""A vertical loop: a full circle in a vertical plane, from rest at its lowest point and back.

The angle is a smooth turn (``references/smooth_turn.py``), so speed, acceleration and jerk are
continuous from hovering to hovering and the path never leaves the circle. At the top the thrust
points downwards when the centripetal acceleration v^2/r exceeds gravity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.references.smooth_turn import SmoothTurn
from quad_mpc_ros.references.trajectory import TrajectoryParameters

_LEAST_PULL = 1.2  # centripetal acceleration at the top over gravity


@dataclass(frozen=True, kw_only=True)
class VerticalLoopParameters(TrajectoryParameters):
    """The loop's own; a split-S has the radius of half a loop."""

    loop_radius: float = parameter(
        1.5,
        doc="vertical_loop: its radius. split_s: that of its inverted part.",
        unit="m",
        above=0.0,
        maximum=1e3,
    )
    loop_speed: float = parameter(
        5.5,
        doc="vertical_loop: speed at its top, the highest.",
        unit="m/s",
        above=0.0,
        maximum=1e3,
    )


class VerticalLoop:
    """The loop, flown forwards in the direction of the nose."""

    periodic = False

    def __init__(self, config: VerticalLoopParameters) -> None:
        radius, speed = config.loop_radius, config.loop_speed
        least = math.sqrt(_LEAST_PULL * config.gravity * radius)
        if speed < least:
            raise ConfigurationError(
                f"{config.owner}.loop_speed",
                speed,
                f"at least {least:.3g} m/s, below which a loop of {radius:g} m radius does not "
                "press the vehicle outwards at its top",
            )
        self._radius = radius
        self._turn = SmoothTurn.with_peak_rate(math.tau, rate=speed / radius)
        self.duration = self._turn.duration
        self._bottom = np.array([*config.origin, config.height])
        self._forward = np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0])

    def at(self, seconds: Array) -> PathSamples:
        """Return the loop at times (n,) [s]."""
        angle, *rates = self._turn.at(seconds)
        w, w_1, w_2 = (rate[:, None] for rate in rates)
        sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
        up = np.array([0.0, 0.0, 1.0])
        along = self._radius * (cosine * self._forward + sine * up)
        inwards = self._radius * (-sine * self._forward + cosine * up)
        return PathSamples(
            p_WB=self._bottom + self._radius * up - inwards,
            v_WB_W=w * along,
            a_WB_W=w**2 * inwards + w_1 * along,
            j_WB_W=3.0 * w * w_1 * inwards + (w_2 - w**3) * along,
        )

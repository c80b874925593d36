"""A flip: a full rotation about the pitch or roll axis during a short climb and fall.

During the rotation the thrust is small and constant (``references/thrust_path.py``); minimum-snap
legs lead from hover to the climb before the rotation, and from the fall back to the start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import End, leg_within
from quad_mpc_ros.references.path import Chain, Path, with_lowest_point
from quad_mpc_ros.references.smooth_turn import SmoothTurn
from quad_mpc_ros.references.thrust_path import TurnParameters, turning_over

_UP = np.array([0.0, 0.0, 1.0])
_CLIMB_ACCELERATION = 0.5  # mean over the way to the turn, over gravity
_RECOVERY_ACCELERATION = 1.2  # over gravity
_SAMPLES = 201


@dataclass(frozen=True, kw_only=True)
class FlipParameters(TurnParameters):
    """Parameters of a flip."""

    flip_axis: str = parameter("pitch", doc="flip: axis of rotation.", choices=("pitch", "roll"))


def flip(config: FlipParameters) -> Path:
    """Return the configured flip, with the lowest point at the configured height."""
    turn = SmoothTurn.with_peak_rate(math.tau, rate=config.flip_rate)
    force = config.coasting_thrust * config.gravity
    # As high up as down: the climb that gravity, less the thrust's mean, takes back half way.
    times = np.linspace(0.0, turn.duration, _SAMPLES)
    lift = force * float(np.mean(np.cos(turn.at(times)[0])))
    climb = 0.5 * (config.gravity - lift) * turn.duration
    entry, over = turning_over(
        turn,
        climb * _UP,
        config,
        towards=_side(config),
        entry=climb / (_CLIMB_ACCELERATION * config.gravity),
    )
    recovery = leg_within(
        End.of(over.at(np.array([over.duration])), 0),
        End.at_rest(np.array([*config.origin, config.height])),
        max_speed=math.inf,
        max_acceleration=_RECOVERY_ACCELERATION * config.gravity,
    )
    return with_lowest_point(Chain([entry, over, recovery]), config.height)


def _side(config: FlipParameters) -> Array:
    """Return the horizontal direction (3,) to which the thrust turns: forwards, or right."""
    forward = np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0])
    return forward if config.flip_axis == "pitch" else np.cross(forward, _UP)

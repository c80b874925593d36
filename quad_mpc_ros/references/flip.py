"""A flip: a whole turn about the pitch or the roll axis, in the air that a short climb gives.

While it turns the vehicle pushes with a constant small thrust and falls freely otherwise
(``references/thrust_path.py``); minimum-snap legs lead from hovering to the climb that the turn
begins with, and from the fall that it ends with back to where it began.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.path import Chain, Moved, Path
from quad_mpc_ros.references.polynomial import End, Leg, leg_within
from quad_mpc_ros.references.smooth_turn import SmoothTurn
from quad_mpc_ros.references.thrust_path import Thrust, ThrustPath

_UP = np.array([0.0, 0.0, 1.0])
_CLIMB_ACCELERATION = 0.5  # mean over the way to the turn, over gravity
_RECOVERY_ACCELERATION = 1.2  # over gravity
_SAMPLES = 201


def flip(config: ReferenceConfig) -> Path:
    """Return the flip of a configuration, its lowest point at the configured height."""
    turn = SmoothTurn.with_peak_rate(math.tau, rate=config.flip_rate)
    force = config.coasting_thrust * config.gravity
    # As high up as down: the climb that gravity, less the thrust's mean, takes back half way.
    times = np.linspace(0.0, turn.duration, _SAMPLES)
    lift = force * float(np.mean(np.cos(turn.at(times)[0])))
    climb = 0.5 * (config.gravity - lift) * turn.duration
    start = np.array([*config.origin, config.height])
    entry = Leg(
        End.at_rest(start),
        coasting_end(climb * _UP, force=force, config=config),
        duration=climb / (_CLIMB_ACCELERATION * config.gravity),
    )
    over = ThrustPath(
        _turning(turn, force=force, towards=_side(config)),
        duration=turn.duration,
        p_WB=entry.at(np.array([entry.duration])).p_WB[0],
        v_WB_W=climb * _UP,
        gravity=config.gravity,
        drag=config.drag,
    )
    recovery = leg_within(
        End.of(over.at(np.array([over.duration])), 0),
        End.at_rest(start),
        max_speed=math.inf,
        max_acceleration=_RECOVERY_ACCELERATION * config.gravity,
    )
    return with_lowest_point(Chain([entry, over, recovery]), config.height)


def coasting_end(v_WB_W: Array, *, force: float, config: ReferenceConfig) -> End:
    """Return the end of a leg at which the vehicle moves freely but for a thrust ``force`` up."""
    acceleration = (force - config.gravity) * _UP - config.drag * v_WB_W
    return End(p_WB=None, v_WB_W=v_WB_W, a_WB_W=acceleration, j_WB_W=-config.drag * acceleration)


def with_lowest_point(path: Path, height: float) -> Path:
    """Return the path lifted until its lowest point is at ``height`` [m]."""
    times = np.linspace(0.0, path.duration, max(_SAMPLES, round(path.duration / 0.002)))
    lowest = float(path.at(times).p_WB[:, 2].min())
    return Moved(path, (height - lowest) * _UP)


def _side(config: ReferenceConfig) -> Array:
    """Return the horizontal direction (3,) that the thrust turns to: forwards, or right."""
    forward = np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0])
    return forward if config.flip_axis == "pitch" else np.cross(forward, _UP)


def _turning(turn: SmoothTurn, *, force: float, towards: Array) -> Thrust:
    def thrust(seconds: Array) -> tuple[Array, Array]:
        angle, rate, _, _ = turn.at(seconds)
        sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
        direction = cosine * _UP + sine * towards
        return force * direction, force * rate[:, None] * (cosine * towards - sine * _UP)

    return thrust

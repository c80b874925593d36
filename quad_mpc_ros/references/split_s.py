"""A split-S: accelerate, roll upside down, pull through downwards, and fly back.

Roll and pull are defined by thrust (``references/thrust_path.py``): low in the roll, higher in the
pull; a minimum-snap leg brakes from the remaining speed. The final heading is opposite to the
initial one, because the body turns with its thrust axis and never about this axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import End, leg_within
from quad_mpc_ros.references.path import Chain, Path, with_lowest_point
from quad_mpc_ros.references.smooth_turn import SmoothTurn
from quad_mpc_ros.references.thrust_path import (
    Thrust,
    ThrustPath,
    TurnParameters,
    turning_over,
)
from quad_mpc_ros.references.vertical_loop import VerticalLoopParameters

_UP = np.array([0.0, 0.0, 1.0])
_RUN_UP_ACCELERATION = 0.5  # mean, over gravity
_BRAKING_ACCELERATION = 1.0  # over gravity
_PULL_SPEED_RATIO = 1.6  # mean over that at the top
_MAX_PULL = 3.0  # strongest, over gravity


@dataclass(frozen=True, kw_only=True)
class SplitSParameters(VerticalLoopParameters, TurnParameters):
    """Parameters of a split-S: parameters of a loop and of a rotation."""


def split_s(config: SplitSParameters) -> Path:
    """Return the configured split-S, with the lowest point at the configured height."""
    force = config.coasting_thrust * config.gravity
    forward = np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0])
    # The speed at which gravity and this thrust bend the inverted path to the radius.
    speed = math.sqrt(config.loop_radius * (config.gravity + force))
    roll = SmoothTurn.with_peak_rate(math.pi, rate=config.flip_rate)
    climb = 0.5 * config.gravity * roll.duration  # gone when the roll ends
    run_up, rolling = turning_over(
        roll,
        speed * forward + climb * _UP,
        config,
        towards=np.cross(forward, _UP),
        entry=speed / (_RUN_UP_ACCELERATION * config.gravity),
    )
    inverted = rolling.at(np.array([rolling.duration]))
    turn = SmoothTurn(math.pi, duration=math.pi * config.loop_radius / (_PULL_SPEED_RATIO * speed))
    pull = ThrustPath(
        _pulling(turn, force=force, hover=config.gravity, forward=forward),
        config,
        duration=turn.duration,
        p_WB=inverted.p_WB[0],
        v_WB_W=inverted.v_WB_W[0],
    )
    braking = leg_within(
        End.of(pull.at(np.array([pull.duration])), 0),
        End.at_rest(None),
        max_speed=math.inf,
        max_acceleration=_BRAKING_ACCELERATION * config.gravity,
    )
    return with_lowest_point(Chain([run_up, rolling, pull, braking]), config.height)


def _pulling(turn: SmoothTurn, *, force: float, hover: float, forward: Array) -> Thrust:
    """Return a thrust from ``force`` downwards via backwards to ``hover`` upwards.

    The thrust is strongest in the second half, where it must also compensate gravity.
    """
    strength = _MAX_PULL * hover
    peak = float(turn.at(np.array([0.5 * turn.duration]))[1][0])

    def thrust(seconds: Array) -> tuple[Array, Array]:
        angle, rate, rate_1, _ = turn.at(seconds)
        share, share_rate = angle / math.pi, rate / math.pi
        amount = force + (hover - force) * share + strength * share * rate / peak
        change = (hover - force) * share_rate + strength * (
            share_rate * rate / peak + share * rate_1 / peak
        )
        sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
        direction = -cosine * _UP - sine * forward
        direction_rate = rate[:, None] * (sine * _UP - cosine * forward)
        amount, change = amount[:, None], change[:, None]
        return amount * direction, change * direction + amount * direction_rate

    return thrust

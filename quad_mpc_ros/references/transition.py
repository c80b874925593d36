# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Transitions between flat states without a jump, and take-off.

Position, velocity, attitude and rates do not jump.

A take-off checks the axes close to the ground. A hover hides reversed or swapped axes and a wrong
heading of the odometry until the vehicle moves. A small circle at a low height moves it in every
direction: the consistency monitor of the MPC (``control/safety/consistency.py``) finds the
contradiction before the vehicle climbs further.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.flatness import yaw_of
from quad_mpc_ros.references.minimum_snap import End, Leg, leg_within
from quad_mpc_ros.references.path import Chain, CircularPath, Path, SmoothTurn, Turned
from quad_mpc_ros.references.trajectory import Trajectory

_STEP_NS = 1_000_000
# Highest over mean rate of a rest-to-rest polynomial of degree 7.
_PEAK = 35.0 / 16.0
CHECK_HEIGHT, CHECK_RADIUS = 0.25, 0.03  # m above the ground, m
_CHECK_DURATION = 1.5  # s; peak acceleration 1.2 m/s^2


@dataclass(frozen=True, kw_only=True, eq=False)
class FlatState:
    """Flat outputs and their derivatives: ``end`` of a leg, yaw [rad] and its rate [rad/s].

    Yaw is the rotation about body z after the shortest tilt from level. ``inverted`` means that
    the thrust points below the horizon.
    """

    end: End
    yaw: float
    yaw_rate: float = 0.0
    inverted: bool = False

    @property
    def p_WB(self) -> Array:
        """The position (3,) [m], which must not be free."""
        assert self.end.p_WB is not None
        return self.end.p_WB

    @staticmethod
    def at_rest(p_WB: Array | None, *, yaw: float) -> FlatState:
        """Return the state of rest at a position (3,) [m], or at any position for None."""
        return FlatState(end=End.at_rest(p_WB), yaw=yaw)


def flat_state_of(trajectory: Trajectory, time_ns: int) -> FlatState:
    """Return the flat state of a smooth trajectory at a time.

    Jerk and yaw rate are forward differences, because the trajectory may start at this time.
    """
    samples = trajectory.at([time_ns, time_ns + _STEP_NS, time_ns + 2 * _STEP_NS])
    R_WB = so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)
    yaw = np.unwrap([yaw_of(R) for R in R_WB])
    return FlatState(
        end=End(
            p_WB=samples.p_WB[0],
            v_WB_W=samples.v_WB_W[0],
            a_WB_W=samples.a_WB_W[0],
            j_WB_W=_slope(samples.a_WB_W),
        ),
        yaw=float(yaw[0]),
        yaw_rate=float(_slope(yaw)),
        inverted=bool(R_WB[0, 2, 2] < 0.0),
    )


def transition(
    start: FlatState,
    goal: FlatState,
    *,
    max_speed: float,
    max_acceleration: float,
    max_yaw_rate: float,
) -> Path:
    """Return the fastest minimum-snap path within the limits [m/s, m/s^2, rad/s].

    The path connects two flat states and turns in the shorter direction.
    """
    turned = math.remainder(goal.yaw - start.yaw, math.tau)
    leg = leg_within(start.end, goal.end, max_speed=max_speed, max_acceleration=max_acceleration)
    enough = _PEAK * abs(turned) / max_yaw_rate
    if leg.duration < enough:
        leg = Leg(start.end, goal.end, duration=enough)
    turn = Leg(
        _yaw_end(start.yaw, start.yaw_rate),
        _yaw_end(start.yaw + turned, goal.yaw_rate),
        duration=leg.duration,
    )
    return Turned(leg, turn)


def _yaw_end(yaw: float, rate: float) -> End:
    """Return a yaw as the first coordinate of an end."""
    rest = End.at_rest(np.array([yaw, 0.0, 0.0]))
    return dataclasses.replace(rest, v_WB_W=np.array([rate, 0.0, 0.0]))


def _slope(values: Array) -> Array:
    """Return the derivative at the first of three values, to second order."""
    return np.asarray((-3.0 * values[0] + 4.0 * values[1] - values[2]) / (2e-9 * _STEP_NS))


def take_off_path(
    p_WB: Array, *, height: float, checks: bool, max_speed: float, max_acceleration: float
) -> Path:
    """Return the path of a take-off from rest to rest.

    Args:
        p_WB: Position on the ground (3,) [m].
        height: Final height [m].
        checks: Whether the path contains the circle; not below the height of the circle.
        max_speed: Speed limit of the climb [m/s].
        max_acceleration: Acceleration limit of the climb [m/s^2].
    """

    def climb(start: Array, end: Array) -> Path:
        ends = End.at_rest(start), End.at_rest(end)
        return leg_within(*ends, max_speed=max_speed, max_acceleration=max_acceleration)

    above = np.array([*p_WB[:2], height])
    low = p_WB + np.array([0.0, 0.0, CHECK_HEIGHT])
    if not (checks and low[2] < height):
        return climb(p_WB, above)
    circle = CircularPath(
        low,
        forwards=np.array([0.0, 1.0, 0.0]),
        inwards=np.array([-1.0, 0.0, 0.0]),
        radius=CHECK_RADIUS,
        turn=SmoothTurn(math.tau, duration=_CHECK_DURATION),
    )
    return Chain([climb(p_WB, low), circle, climb(low, above)])

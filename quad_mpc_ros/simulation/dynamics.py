"""Continuous dynamics of the plant, as printed in the paper and of the true rigid body.

The controller predicts by a model of its own (``model/rollout.py``), not by these: they are apart
on purpose.

World ENU, body FLU: gravity is -g along world z and thrust is along +z of the body. The paper
writes NED/FRD, where both signs flip.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.state import ATTITUDE, POSITION, VELOCITY, Input, State
from quad_mpc_ros.model.vehicle import Vehicle

Dynamics = Callable[[State, Input, Vehicle], Array]
"""Returns the time derivative of the state as a tangent vector (9,): m/s, m/s^2, rad/s."""


def paper_dynamics(x: State, u: Input, vehicle: Vehicle) -> Array:
    """Eq. (3) literally: the velocity is in body axes, but nothing transports it as they turn."""
    rate = np.empty(9)
    rate[POSITION] = x.R_WB @ x.v_WB_B
    rate[VELOCITY] = -vehicle.gravity * x.R_WB[2] - vehicle.drag * x.v_WB_B
    rate[VELOCITY.stop - 1] += vehicle.thrust(u.throttle) / vehicle.mass
    rate[ATTITUDE] = u.w_WB_B
    return rate


def rigid_body_dynamics(x: State, u: Input, vehicle: Vehicle) -> Array:
    """The true rigid body: Eq. (3) with the transport term -omega x v of a turning frame."""
    rate = paper_dynamics(x, u, vehicle)
    rate[VELOCITY] -= so3.cross(u.w_WB_B, x.v_WB_B)
    return rate


DYNAMICS: dict[str, Dynamics] = {"rigid_body": rigid_body_dynamics, "paper": paper_dynamics}


class InputCourse(NamedTuple):
    """An input that changes in the course of one step, and the turns (3, 3) that it makes."""

    start: Input
    middle: Input
    end: Input
    first_turn: Array
    """Rotation over the first half of the step."""
    second_turn: Array
    """Rotation over the second half."""


def held(u: Input, *, duration: float) -> InputCourse:
    """Return the course of an input that does not change over ``duration`` [s]."""
    half_turn = so3.exp(0.5 * duration * u.w_WB_B)
    return InputCourse(u, u, u, half_turn, half_turn)


def integrate(
    x: State, u: Input, vehicle: Vehicle, *, dynamics: Dynamics, duration: float
) -> State:
    """Return the state after ``duration`` [s] with the input held: one Runge-Kutta step, order 4.

    With the body rate held the attitude R exp(omega t) is exact; position and velocity are
    integrated along it.
    """
    course = held(u, duration=duration)
    return integrate_along(x, course, vehicle, dynamics=dynamics, duration=duration)


def integrate_along(
    x: State, course: InputCourse, vehicle: Vehicle, *, dynamics: Dynamics, duration: float
) -> State:
    """Return the state after ``duration`` [s] of a changing input: one Runge-Kutta step, order 4.

    The attitude is turned as the course says.
    """
    R_half = x.R_WB @ course.first_turn
    R_full = R_half @ course.second_turn

    def moved(rate: Array, step: float, R_WB: Array) -> State:
        return State(
            p_WB=x.p_WB + step * rate[POSITION],
            v_WB_B=x.v_WB_B + step * rate[VELOCITY],
            R_WB=R_WB,
        )

    k1 = dynamics(x, course.start, vehicle)
    k2 = dynamics(moved(k1, 0.5 * duration, R_half), course.middle, vehicle)
    k3 = dynamics(moved(k2, 0.5 * duration, R_half), course.middle, vehicle)
    k4 = dynamics(moved(k3, duration, R_full), course.end, vehicle)
    return moved((k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0, duration, R_full)

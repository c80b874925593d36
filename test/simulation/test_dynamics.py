# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The equations of motion against physics and an integrator of another kind."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from fixtures.plant_motion import integrate, rate
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.control.model.vehicle import Vehicle

BOTH = pytest.mark.parametrize("dynamics", ["paper", "rigid_body"])


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle()


def flown(
    x: State, u: Input, vehicle: Vehicle, *, dynamics: str, duration: float, steps: int
) -> State:
    for _ in range(steps):
        x = integrate(x, u, vehicle, dynamics=dynamics, duration=duration / steps)
    return x


@BOTH
def test_hover_is_an_equilibrium(dynamics: str, vehicle: Vehicle) -> None:
    heading = Rotation.from_euler("z", 1.0).as_matrix()
    x = State(p_WB=np.zeros(3), v_WB_B=np.zeros(3), R_WB=heading)
    u = Input(throttle=vehicle.hover_throttle, w_WB_B=np.zeros(3))
    held = rate(x, u, vehicle, dynamics=dynamics)
    assert_allclose(held, np.zeros(9), atol=1e-14)


def quaternion_rate(q: Array, w_B: Array) -> Array:
    """Return dq/dt = 1/2 q w of a scalar-first quaternion."""
    w, x, y, z = q
    a, b, c = w_B
    return 0.5 * np.array(
        [
            -x * a - y * b - z * c,
            w * a + y * c - z * b,
            w * b + z * a - x * c,
            w * c + x * b - y * a,
        ]
    )


def turned(q: Array, vector: Array) -> Array:
    """Return the vector turned by a scalar-first quaternion."""
    return vector + 2.0 * np.cross(q[1:], np.cross(q[1:], vector) + q[0] * vector)


def exact(
    x: State, u: Input, vehicle: Vehicle, *, transported: bool, duration: float
) -> tuple[Array, Array, Array]:
    """Return position, world velocity and rotation, integrated to 1e-12.

    The rigid body is integrated in world coordinates; Eq. (3) with its velocity in the body.
    """
    a, b, c = vehicle.thrust_curve
    lift = 4.0 * (a * u.throttle**2 + b * u.throttle + c) / vehicle.mass
    down = np.array([0.0, 0.0, -vehicle.gravity])
    up_B = np.array([0.0, 0.0, lift])

    def world(_: float, y: Array) -> Array:
        v_W, q = y[3:6], y[6:]
        a_W = down + turned(q, up_B) - vehicle.drag * v_W
        return np.concatenate((v_W, a_W, quaternion_rate(q, u.w_WB_B)))

    def body(_: float, y: Array) -> Array:
        v_B, q = y[3:6], y[6:]
        back = q * [1.0, -1.0, -1.0, -1.0]
        a_B = turned(back, down) + up_B - vehicle.drag * v_B
        return np.concatenate((turned(q, v_B), a_B, quaternion_rate(q, u.w_WB_B)))

    q0 = np.roll(Rotation.from_matrix(x.R_WB).as_quat(), 1)
    start = np.concatenate((x.p_WB, x.v_WB_W if transported else x.v_WB_B, q0))
    end = solve_ivp(
        world if transported else body,
        (0.0, duration),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    ).y[:, -1]
    q = end[6:] / np.linalg.norm(end[6:])
    return (
        end[:3],
        end[3:6] if transported else turned(q, end[3:6]),
        Rotation.from_quat(np.roll(q, -1)).as_matrix(),
    )


TUMBLING = State(
    p_WB=np.array([1.0, -2.0, 3.0]),
    v_WB_B=np.array([4.0, -1.0, 2.0]),
    R_WB=Rotation.from_euler("xyz", [0.5, -0.8, 2.0]).as_matrix(),
)
TUMBLE = Input(throttle=0.6, w_WB_B=np.array([6.0, -4.0, 3.0]))


@BOTH
def test_integration_agrees_with_an_independent_one(dynamics: str, vehicle: Vehicle) -> None:
    p, v_W, R = exact(
        TUMBLING, TUMBLE, vehicle, transported=dynamics == "rigid_body", duration=0.5
    )
    x = flown(TUMBLING, TUMBLE, vehicle, dynamics=dynamics, duration=0.5, steps=1000)
    assert_allclose(x.p_WB, p, rtol=0.0, atol=1e-10)
    assert_allclose(x.v_WB_W, v_W, rtol=0.0, atol=1e-10)
    assert_allclose(x.R_WB, R, rtol=0.0, atol=1e-11)


@BOTH
def test_integration_is_of_fourth_order(dynamics: str, vehicle: Vehicle) -> None:
    p, v_W, R = exact(
        TUMBLING, TUMBLE, vehicle, transported=dynamics == "rigid_body", duration=0.5
    )
    errors = []
    for steps in (8, 16, 32):
        x = flown(TUMBLING, TUMBLE, vehicle, dynamics=dynamics, duration=0.5, steps=steps)
        errors.append(np.linalg.norm(np.concatenate((x.p_WB - p, x.v_WB_W - v_W))))
        # The body rate is constant, so the attitude has no error at any step.
        assert_allclose(x.R_WB, R, rtol=0.0, atol=1e-11)
    orders = [math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)]
    assert all(3.7 < order < 4.5 for order in orders), orders

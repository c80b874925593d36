# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The planner's equations against the core's model, which was written without them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros import load_config
from quad_mpc_ros.extras.racing.planning.limits import planned_vehicle
from quad_mpc_ros.extras.racing.planning.model import F, P, Q, V, W, model_of

pytest.importorskip("casadi")

AIR = [
    *(f"{node}.drag=[0.3,0.2,0.5]" for node in ("mpc", "simulator", "reference")),
    *(f"{node}.rotor_drag=[0.4,0.5,0.1]" for node in ("mpc", "simulator", "reference")),
    *(f"{node}.translational_lift=0.02" for node in ("mpc", "simulator", "reference")),
]
LAGS = ["mpc.rate_time_constant=[0.03,0.05,0.1]", "mpc.thrust_time_constant=0.04"]


@pytest.mark.parametrize("seed", range(5))
def test_a_step_agrees_with_the_integrated_equations(seed: int) -> None:
    """Drag along each axis, drag of the rotors, lift and lags; specific force by the vehicle."""
    random = np.random.default_rng(seed)
    config = load_config("agile", assignments=[*AIR, *LAGS])
    vehicle = config.mpc.vehicle()
    planned = planned_vehicle(config.mpc, config.simulator, config.reference)
    model = model_of(planned, start=np.zeros(3), start_yaw=0.0, lowest=0.0)
    q = Rotation.random(random_state=seed)
    x = np.concatenate(
        (
            *(random.uniform(-5, 5, 3), random.uniform(-8, 8, 3)),
            *(np.roll(q.as_quat(), 1), random.uniform(-5, 5, 3), random.uniform(5, 25, 1)),
        )
    )
    u = np.append(random.uniform(-8, 8, 3), random.uniform(5.0, 30.0))
    lags, h = np.array([0.03, 0.05, 0.1, 0.04]), 0.05

    def acceleration(v: np.ndarray, R: np.ndarray, thrust: float) -> np.ndarray:
        u_B = R.T @ v
        rotors = np.sqrt(thrust / vehicle.gravity) * np.array([0.4, 0.5, 0.1])
        force = np.array([0.0, 0.0, thrust]) - (np.array([0.3, 0.2, 0.5]) + rotors) * u_B
        force[2] += 0.02 * (u_B[0] ** 2 + u_B[1] ** 2)
        return R @ force - np.array([0.0, 0.0, vehicle.gravity])

    def rate(time: float, y: np.ndarray) -> np.ndarray:
        v, R, w, thrust = y[:3], y[3:12].reshape(3, 3), y[12:15], float(y[15])
        skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        turn = (R @ skew).ravel()
        return np.concatenate((acceleration(v, R, thrust), turn, (u - y[12:]) / lags))

    # The core's own statement of it: the thrust that an acceleration needs.
    R = q.as_matrix()
    a = acceleration(x[V], R, float(x[F][0]))
    needed = vehicle.specific_thrust(a_WB_W=a[None], v_WB_W=x[V][None], R_WB=R[None])
    assert_allclose(needed, x[F])
    assert_allclose(np.array(model.acceleration(x, u)).ravel(), a, atol=1e-9)
    begin = np.concatenate((x[V], q.as_matrix().ravel(), x[W], x[F]))
    found = solve_ivp(rate, (0.0, h), begin, rtol=1e-10, atol=1e-10, dense_output=True)
    end = found.y[:, -1]
    stepped = np.array(model.step(x, u, h)).ravel()
    places = np.linspace(0.0, h, 201)
    way = np.trapezoid(found.sol(places)[:3], places, axis=1)
    assert_allclose(stepped[P] - x[P], way, atol=2e-4)
    assert_allclose(stepped[V], end[:3], atol=3e-3)
    assert_allclose(np.append(stepped[W], stepped[F]), end[12:], atol=1e-8)
    turned = Rotation.from_quat(np.roll(stepped[Q], -1)).as_matrix()
    off = Rotation.from_matrix(turned.T @ end[3:12].reshape(3, 3)).magnitude()
    assert off < 1e-3

"""The model of the future against an independent integrator, its Jacobians through ⊞ and ⊟."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.prediction import (
    STATE_SIZE,
    Disturbance,
    PredictedState,
    PredictionModel,
    Rollout,
)
from quad_mpc_ros.core import so3
from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.core.vehicle import Vehicle

VEHICLE = Vehicle()
STEP = 0.05
LAGS = [(0.0, 0.0), (0.03, 0.0), (0.0, 0.04), (0.03, 0.04), (0.5, 0.3)]
DISTURBANCE = Disturbance(a_W=np.array([0.8, -1.1, 0.4]), thrust_scale=0.85)


def model(steps: int, lags: tuple[float, float]) -> PredictionModel:
    return PredictionModel(
        VEHICLE, steps=steps, step=STEP, rate_time_constant=lags[0], thrust_time_constant=lags[1]
    )


def start(seed: int) -> PredictedState:
    rng = np.random.default_rng(seed)
    return PredictedState(
        p_WB=rng.normal(size=3),
        v_WB_W=3.0 * rng.normal(size=3),
        R_WB=so3.exp(rng.normal(size=3)),
        w_WB_B=2.0 * rng.normal(size=3),
        throttle=0.4,
    )


def commands(steps: int, seed: int, *, rate: float = 4.0) -> Array:
    rng = np.random.default_rng(seed)
    return np.column_stack(
        (rng.uniform(0.1, 0.9, steps), np.clip(rng.normal(size=(steps, 3)), -1, 1) * rate)
    )


def integrated(x: PredictedState, inputs: Array, lags: tuple[float, float]) -> Array:
    """Return position, velocity and quaternion after the inputs, by scipy on a quaternion."""
    y = np.concatenate(
        (
            x.p_WB,
            x.v_WB_W,
            Rotation.from_matrix(x.R_WB).as_quat(),
            x.w_WB_B,
            [x.throttle],
        )
    )
    a, b, c = VEHICLE.thrust_curve
    for u in inputs:
        if lags[0] == 0.0:
            y[10:13] = u[1:]
        if lags[1] == 0.0:
            y[13] = u[0]

        def slope(_: float, y: Array, u: Array = u) -> Array:
            w, s = y[10:13], y[13]
            body_z = Rotation.from_quat(y[6:10]).apply([0.0, 0.0, 1.0])
            thrust = DISTURBANCE.thrust_scale * 4.0 * (a * s * s + b * s + c)
            dv = thrust / VEHICLE.mass * body_z - VEHICLE.drag * y[3:6] + DISTURBANCE.a_W
            dv[2] -= VEHICLE.gravity
            q_xyz, q_w = y[6:9], y[9]
            dq = 0.5 * np.append(q_w * w + np.cross(q_xyz, w), -q_xyz @ w)
            dw = (u[1:] - w) / lags[0] if lags[0] else np.zeros(3)
            ds = (u[0] - s) / lags[1] if lags[1] else 0.0
            return np.concatenate((y[3:6], dv, dq, dw, [ds]))

        y = solve_ivp(slope, (0.0, STEP), y, rtol=1e-10, atol=1e-12).y[:, -1]
    return y


@pytest.mark.parametrize("lags", LAGS)
def test_rollout_agrees_with_an_independent_integrator(lags: tuple[float, float]) -> None:
    """To millimetres over half a second of violent flying; the substep's error is of order 2."""
    x, inputs = start(1), commands(10, 2)
    rollout = model(10, lags).roll_out(x, inputs, DISTURBANCE)
    exact = integrated(x, inputs, lags)
    np.testing.assert_allclose(rollout.p_WB[-1], exact[0:3], atol=2e-3)
    np.testing.assert_allclose(rollout.v_WB_W[-1], exact[3:6], atol=8e-3)
    difference = rollout.R_WB[-1].T @ Rotation.from_quat(exact[6:10]).as_matrix()
    assert np.linalg.norm(so3.log(difference)) < 3e-3
    if lags[0]:
        np.testing.assert_allclose(rollout.w_WB_B[-1], exact[10:13], rtol=1e-7)
    if lags[1]:
        assert rollout.throttle[-1] == pytest.approx(exact[13], rel=1e-7)


@pytest.mark.parametrize("lags", LAGS)
@pytest.mark.parametrize("stage", [0, 4, 9])
def test_jacobians_are_the_derivatives_through_box_plus(
    lags: tuple[float, float], stage: int
) -> None:
    x, inputs = start(3), commands(10, 4, rate=15.0)
    rollout = model(10, lags).roll_out(x, inputs, DISTURBANCE)
    A, B = model(10, lags).jacobians(rollout)

    def next_state(dx: Array, du: Array) -> Array:
        moved = PredictedState(
            p_WB=rollout.p_WB[stage] + dx[0:3],
            v_WB_W=rollout.v_WB_W[stage] + dx[3:6],
            R_WB=rollout.R_WB[stage] @ so3.exp(dx[6:9]),
            w_WB_B=rollout.w_WB_B[stage] + dx[9:12],
            throttle=rollout.throttle[stage] + dx[12],
        )
        end = model(1, lags).roll_out(moved, (inputs[stage] + du)[None], DISTURBANCE)
        return np.concatenate(
            (
                end.p_WB[1],
                end.v_WB_W[1],
                so3.log(rollout.R_WB[stage + 1].T @ end.R_WB[1]),
                end.w_WB_B[1],
                [end.throttle[1]],
            )
        )

    h = 1e-6
    zero_x, zero_u = np.zeros(STATE_SIZE), np.zeros(4)
    by_x = [
        (next_state(h * e, zero_u) - next_state(-h * e, zero_u)) / (2 * h)
        for e in np.eye(STATE_SIZE)
    ]
    by_u = [(next_state(zero_x, h * e) - next_state(zero_x, -h * e)) / (2 * h) for e in np.eye(4)]
    np.testing.assert_allclose(A[stage], np.column_stack(by_x), atol=2e-8)
    np.testing.assert_allclose(B[stage], np.column_stack(by_u), atol=2e-8)


@pytest.mark.parametrize("lags", LAGS)
def test_a_horizon_is_its_stages_one_after_another(lags: tuple[float, float]) -> None:
    x, inputs = start(5), commands(6, 6)
    whole = model(6, lags).roll_out(x, inputs, DISTURBANCE)
    for u in inputs:
        end: Rollout = model(1, lags).roll_out(x, u[None], DISTURBANCE)
        x = PredictedState(
            p_WB=end.p_WB[1],
            v_WB_W=end.v_WB_W[1],
            R_WB=end.R_WB[1],
            w_WB_B=end.w_WB_B[1],
            throttle=float(end.throttle[1]),
        )
    np.testing.assert_allclose(whole.p_WB[-1], x.p_WB, atol=1e-12)
    np.testing.assert_allclose(whole.v_WB_W[-1], x.v_WB_W, atol=1e-12)
    np.testing.assert_allclose(whole.R_WB[-1], x.R_WB, atol=1e-12)


def test_a_vanishing_lag_is_no_lag() -> None:
    x, inputs = start(7), commands(10, 8)
    none = model(10, (0.0, 0.0)).roll_out(x, inputs, DISTURBANCE)
    tiny = model(10, (1e-7, 1e-7)).roll_out(x, inputs, DISTURBANCE)
    np.testing.assert_allclose(tiny.p_WB, none.p_WB, atol=1e-5)


def test_without_drag_the_motion_is_ballistic() -> None:
    vehicle = dataclasses.replace(VEHICLE, drag=0.0, thrust_curve=(1.88, 2.8, 0.0))
    free = PredictionModel(
        vehicle, steps=10, step=STEP, rate_time_constant=0.0, thrust_time_constant=0.0
    )
    x = start(9)
    rollout = free.roll_out(x, np.zeros((10, 4)), Disturbance(a_W=np.zeros(3), thrust_scale=1.0))
    fallen = x.p_WB + 0.5 * x.v_WB_W + np.array([0.0, 0.0, -0.5 * 9.81 * 0.25])
    np.testing.assert_allclose(rollout.p_WB[-1], fallen, atol=1e-12)

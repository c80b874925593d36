"""The model of the future against an independent integrator, its Jacobians through ⊞ and ⊟."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.rollout import (
    STATE_SIZE,
    SUBSTEPS,
    Disturbance,
    Motion,
    jacobians,
    model_of,
    motion,
    roll_out,
)
from quad_mpc_ros.model.vehicle import Vehicle

VEHICLE = Vehicle()
STEP = 0.05
LAGS = [(0.0, 0.0), (0.03, 0.0), (0.0, 0.04), (0.03, 0.04), (0.5, 0.3)]
DISTURBANCE = Disturbance(a_W=np.array([0.8, -1.1, 0.4]), thrust_scale=0.85)


def start(seed: int) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(
        p_WB=rng.normal(size=(1, 3)),
        v_WB_W=3.0 * rng.normal(size=(1, 3)),
        R_WB=so3.exp(rng.normal(size=(1, 3))),
        actuators=np.array([[0.4, *(2.0 * rng.normal(size=3))]]),
    )


def rolled_out(
    x: Motion,
    inputs: Array,
    lags: tuple[float, float],
    *,
    disturbance: Disturbance = DISTURBANCE,
    vehicle: Vehicle = VEHICLE,
) -> Motion:
    """Return the states that inputs (N, 4) held over whole stages, or (N, M, 4), lead to."""
    if inputs.ndim == 2:
        inputs = np.repeat(inputs[:, None, :], SUBSTEPS, axis=1)
    states = motion(len(inputs) + 1)
    model = model_of(vehicle, rate_time_constant=lags[0], thrust_time_constant=lags[1])
    roll_out(model, STEP, disturbance.a_W, disturbance.thrust_scale, inputs, x, states)
    return states


def last(states: Motion) -> Motion:
    return Motion(*(values[-1:].copy() for values in states))


def commands(steps: int, seed: int, *, rate: float = 4.0) -> Array:
    rng = np.random.default_rng(seed)
    return np.column_stack(
        (rng.uniform(0.1, 0.9, steps), np.clip(rng.normal(size=(steps, 3)), -1, 1) * rate)
    )


def integrated(x: Motion, inputs: Array, lags: tuple[float, float]) -> Array:
    """Return position, velocity and quaternion after the inputs, by scipy on a quaternion."""
    y = np.concatenate(
        (
            x.p_WB[0],
            x.v_WB_W[0],
            Rotation.from_matrix(x.R_WB[0]).as_quat(),
            x.actuators[0, 1:],
            x.actuators[0, :1],
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
    states = rolled_out(x, inputs, lags)
    exact = integrated(x, inputs, lags)
    np.testing.assert_allclose(states.p_WB[-1], exact[0:3], atol=2e-3)
    np.testing.assert_allclose(states.v_WB_W[-1], exact[3:6], atol=8e-3)
    difference = states.R_WB[-1].T @ Rotation.from_quat(exact[6:10]).as_matrix()
    assert np.linalg.norm(so3.log(difference)) < 3e-3
    if lags[0]:
        np.testing.assert_allclose(states.actuators[-1, 1:], exact[10:13], rtol=1e-7)
    if lags[1]:
        assert states.actuators[-1, 0] == pytest.approx(exact[13], rel=1e-7)


@pytest.mark.parametrize("lags", LAGS)
@pytest.mark.parametrize("held", [(), (1,), (0, 3)])
@pytest.mark.parametrize("stage", [0, 4, 9])
def test_jacobians_are_the_derivatives_through_box_plus(
    lags: tuple[float, float], held: tuple[int, ...], stage: int
) -> None:
    """Also where a bound holds the commands of some substeps."""
    rng = np.random.default_rng(5)
    inputs = np.repeat(commands(10, 4, rate=15.0)[:, None, :], SUBSTEPS, axis=1)
    inputs = inputs + 0.05 * rng.normal(size=inputs.shape)
    free = np.ones_like(inputs)
    free[:, list(held)] = 0.0
    states = rolled_out(start(3), inputs, lags)
    model = model_of(VEHICLE, rate_time_constant=lags[0], thrust_time_constant=lags[1])
    A, B = np.zeros((10, STATE_SIZE, STATE_SIZE)), np.zeros((10, STATE_SIZE, 4))
    d = DISTURBANCE
    jacobians(model, STEP, d.a_W, d.thrust_scale, inputs, free, states, states, A, B)

    def next_state(dx: Array, du: Array) -> Array:
        moved = Motion(
            p_WB=states.p_WB[None, stage] + dx[0:3],
            v_WB_W=states.v_WB_W[None, stage] + dx[3:6],
            R_WB=states.R_WB[None, stage] @ so3.exp(dx[6:9]),
            actuators=states.actuators[None, stage] + dx[[12, 9, 10, 11]],
        )
        end = rolled_out(moved, (inputs[stage] + free[stage] * du)[None], lags)
        return np.concatenate(
            (
                end.p_WB[1],
                end.v_WB_W[1],
                so3.log(states.R_WB[stage + 1].T @ end.R_WB[1]),
                end.actuators[1, 1:],
                end.actuators[1, :1],
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


def test_without_lags_the_small_jacobians_are_those_of_the_large() -> None:
    inputs = np.repeat(commands(3, 4)[:, None, :], SUBSTEPS, axis=1)
    states, free = rolled_out(start(3), inputs, (0.0, 0.0)), np.ones_like(inputs)
    model = model_of(VEHICLE, rate_time_constant=0.0, thrust_time_constant=0.0)
    found = []
    for size in (9, STATE_SIZE):
        A, B = np.zeros((3, size, size)), np.zeros((3, size, 4))
        d = DISTURBANCE
        jacobians(model, STEP, d.a_W, d.thrust_scale, inputs, free, states, states, A, B)
        found.append((A[:, :9, :9], B[:, :9]))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])


@pytest.mark.parametrize("lags", LAGS)
def test_a_horizon_is_its_stages_one_after_another(lags: tuple[float, float]) -> None:
    x, inputs = start(5), commands(6, 6)
    whole = rolled_out(x, inputs, lags)
    for u in inputs:
        x = last(rolled_out(x, u[None], lags))
    np.testing.assert_allclose(whole.p_WB[-1], x.p_WB[0], atol=1e-12)
    np.testing.assert_allclose(whole.v_WB_W[-1], x.v_WB_W[0], atol=1e-12)
    np.testing.assert_allclose(whole.R_WB[-1], x.R_WB[0], atol=1e-12)


def test_a_vanishing_lag_is_no_lag() -> None:
    x, inputs = start(7), commands(10, 8)
    none, tiny = rolled_out(x, inputs, (0.0, 0.0)), rolled_out(x, inputs, (1e-7, 1e-7))
    np.testing.assert_allclose(tiny.p_WB, none.p_WB, atol=1e-5)


def test_without_drag_the_motion_is_ballistic() -> None:
    vehicle = dataclasses.replace(VEHICLE, drag=0.0, thrust_curve=(1.88, 2.8, 0.0))
    nothing = Disturbance(a_W=np.zeros(3), thrust_scale=1.0)
    x = start(9)
    states = rolled_out(x, np.zeros((10, 4)), (0.0, 0.0), disturbance=nothing, vehicle=vehicle)
    fallen = x.p_WB[0] + 0.5 * x.v_WB_W[0] + np.array([0.0, 0.0, -0.5 * 9.81 * 0.25])
    np.testing.assert_allclose(states.p_WB[-1], fallen, atol=1e-12)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The model of the future against an independent integrator, its Jacobians through ⊞ and ⊟."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from fixtures.records import actuators_of, changed, state_of
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.jacobians import STATE_SIZE, jacobians
from quad_mpc_ros.control.model.parameters import ModelParameters, parameters_of
from quad_mpc_ros.control.model.rollout import SUBSTEPS, StateRecord, roll_out
from quad_mpc_ros.control.model.vehicle import ActuatorLags, Vehicle

ROOT = Path(__file__).resolve().parents[3]
VEHICLE = Vehicle()
STEP = 0.05
# Of rates, throttle and torque [s].
LAGS = [
    (0.0, 0.0, 0.0),
    (0.03, 0.0, 0.0),
    (0.0, 0.04, 0.0),
    (0.03, 0.04, 0.0),
    (0.5, 0.3, 0.0),
    (0.04, 0.04, 0.15),
    (0.2, 0.3, 0.04),
]
BOUNDED = [(0.03, 0.04, 0.0), (0.04, 0.04, 0.15), (0.2, 0.3, 0.04)]
MOST = 60.0  # rad/s^2, of the angular acceleration demanded
SLOWER_YAW = 2.5  # than roll and pitch
FALLING = 1.6  # time constant of a falling throttle over that of a rising one
A_W, THRUST_SCALE = (0.8, -1.1, 0.4), 0.85
# Drag of one vehicle per axis with lift, and a plate's, that differs more than any vehicle's.
UNEVEN = Vehicle(drag=(0.3, 0.15, 0.45), translational_lift=0.015)
ROTORS = Vehicle(drag=(0.1, 0.1, 0.1), rotor_drag=(0.4, 0.3, 0.6), translational_lift=0.015)
VEHICLES = [VEHICLE, UNEVEN, ROTORS, Vehicle(drag=(0.0, 0.8, 1.5), translational_lift=0.05)]


def start(seed: int) -> StateRecord:
    rng = np.random.default_rng(seed)
    return state_of(
        p_WB=rng.normal(size=3),
        v_WB_W=3.0 * rng.normal(size=3),
        R_WB=so3.exp(rng.normal(size=3)),
        actuators=[0.4, *(2.0 * rng.normal(size=3))],
    )


def model_of(
    lags: tuple[float, float, float],
    *,
    vehicle: Vehicle = VEHICLE,
    disturbed: bool = True,
    most: float = 0.0,
) -> ModelParameters:
    actuators = ActuatorLags(
        rate=lags[0],
        thrust=lags[1],
        thrust_down=FALLING * lags[1],
        torque=lags[2],
        angular_acceleration_max=most,
    )
    model = parameters_of(vehicle, actuators)[()]
    model.rate_time_constants[2] = SLOWER_YAW * lags[0]
    return changed(model, a_W=A_W, thrust_scale=THRUST_SCALE) if disturbed else model


def rolled_out(x: StateRecord, inputs: Array, model: ModelParameters) -> RecordArray[StateRecord]:
    """Return the states that inputs (N, 4) held over whole stages, or (N, M, 4), lead to."""
    if inputs.ndim == 2:
        inputs = np.repeat(inputs[:, None, :], SUBSTEPS, axis=1)
    states = StateRecord.zeros(len(inputs) + 1)
    roll_out(model, STEP, inputs, x, states)
    return states


def commands(steps: int, seed: int, *, rate: float = 4.0) -> Array:
    rng = np.random.default_rng(seed)
    return np.column_stack(
        (rng.uniform(0.1, 0.9, steps), np.clip(rng.normal(size=(steps, 3)), -1, 1) * rate)
    )


def integrated(
    x: StateRecord,
    inputs: Array,
    lags: tuple[float, float, float],
    vehicle: Vehicle,
    *,
    most: float = math.inf,
) -> Array:
    """Return position, velocity and quaternion after the inputs, by scipy on a quaternion."""
    y = np.concatenate(
        (
            x.p_WB,
            x.v_WB_W,
            Rotation.from_matrix(x.R_WB).as_quat(),
            x.w_WB_B,
            [x.throttle],
            x.angular_acceleration,
        )
    )
    a, b, c = vehicle.thrust_curve
    drag, lift = np.array(per_axis(vehicle.drag)), vehicle.translational_lift
    rotors = np.array(per_axis(vehicle.rotor_drag))
    for u in inputs:
        if lags[0] == 0.0:
            y[10:13] = u[1:]
        if lags[1] == 0.0:
            y[13] = u[0]

        def slope(_: float, y: Array, u: Array = u) -> Array:
            w, s, alpha = y[10:13], y[13], y[14:17]
            attitude = Rotation.from_quat(y[6:10])
            v_B = attitude.inv().apply(y[3:6])
            thrust = THRUST_SCALE * 4.0 * (a * s * s + b * s + c)
            turning = np.sqrt(max(thrust, 0.0) / (vehicle.mass * vehicle.gravity))
            force = -(drag + turning * rotors) * v_B
            force[2] += thrust / vehicle.mass + lift * (v_B[0] ** 2 + v_B[1] ** 2)
            dv = attitude.apply(force) + np.array(A_W)
            dv[2] -= vehicle.gravity
            q_xyz, q_w = y[6:9], y[9]
            dq = 0.5 * np.append(q_w * w + np.cross(q_xyz, w), -q_xyz @ w)
            rate_lags = lags[0] * np.array([1.0, 1.0, SLOWER_YAW])
            dw = np.clip((u[1:] - w) / rate_lags, -most, most) if lags[0] else np.zeros(3)
            ds = (u[0] - s) / lags[1] if lags[1] else 0.0
            if u[0] < s:
                ds /= FALLING
            turning_up = (dw - alpha) / lags[2] if lags[2] else np.zeros(3)
            dw = alpha if lags[2] else dw
            return np.concatenate((y[3:6], dv, dq, dw, [ds], turning_up))

        # The bound is a kink of the slope, which long steps of the integrator would pass over.
        longest = math.inf if math.isinf(most) else 1e-3
        y = solve_ivp(slope, (0.0, STEP), y, rtol=1e-10, atol=1e-12, max_step=longest).y[:, -1]
    return y


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("lags", LAGS)
def test_rollout_agrees_with_an_independent_integrator(
    lags: tuple[float, float, float], vehicle: Vehicle
) -> None:
    """To millimetres over half a second of violent flying; the substep's error is of order 2."""
    x, inputs = start(1), commands(10, 2)
    states = rolled_out(x, inputs, model_of(lags, vehicle=vehicle))
    exact = integrated(x, inputs, lags, vehicle)
    end = states[-1]
    np.testing.assert_allclose(end.p_WB, exact[0:3], atol=2e-3)
    np.testing.assert_allclose(end.v_WB_W, exact[3:6], atol=8e-3)
    difference = end.R_WB.T @ Rotation.from_quat(exact[6:10]).as_matrix()
    assert np.linalg.norm(so3.log(difference)) < 3e-3
    if lags[0]:
        np.testing.assert_allclose(end.w_WB_B, exact[10:13], rtol=1e-7)
    if lags[1]:
        assert end.throttle == pytest.approx(exact[13], rel=1e-7)


@pytest.mark.parametrize("lags", BOUNDED)
def test_rollout_bounds_the_angular_acceleration(lags: tuple[float, float, float]) -> None:
    """Only the mean demand of a substep is bounded, so that the error shrinks with its length."""
    x, inputs = start(1), commands(10, 2, rate=15.0)
    exact = integrated(x, inputs, lags, VEHICLE, most=MOST)
    finely = np.repeat(inputs[:, None, :], 8 * SUBSTEPS, axis=1)
    ends = (
        rolled_out(x, inputs, model_of(lags))[-1],
        rolled_out(x, inputs, model_of(lags, most=MOST))[-1],
        rolled_out(x, finely, model_of(lags, most=MOST))[-1],
    )
    unbounded, coarse, fine = (np.abs(end.w_WB_B - exact[10:13]).max() for end in ends)
    assert unbounded > 1.5
    assert coarse < 0.2
    assert fine < 0.03


@pytest.mark.parametrize("lags", LAGS)
@pytest.mark.parametrize("held", [(), (0, 3)])
@pytest.mark.parametrize("stage", [0, 9])
def test_jacobians_equal_finite_differences_through_box_plus(
    lags: tuple[float, float, float], held: tuple[int, ...], stage: int
) -> None:
    """Also where a bound holds the commands of some substeps."""
    check_jacobians(model_of(lags), held, stage)


def test_jacobians_neglect_what_anisotropic_drag_adds() -> None:
    check_jacobians(model_of(LAGS[0], vehicle=UNEVEN), (), 0, atol=0.02)


@pytest.mark.parametrize("lags", BOUNDED)
@pytest.mark.parametrize("stage", [2, 5, 9])
def test_jacobians_of_bounded_accelerations_equal_finite_differences(
    lags: tuple[float, float, float], stage: int
) -> None:
    """At the bound the command has no effect, and each axis is there for other substeps."""
    B = check_jacobians(model_of(lags, most=MOST), (), stage)
    rates_by_commands = np.diag(B[9:12, 1:])
    assert (rates_by_commands == 0.0).any()


def check_jacobians(
    model: ModelParameters, held: tuple[int, ...], stage: int, *, atol: float = 2e-8
) -> Array:
    """Compare the Jacobians of a stage with finite differences; return B (16, 4)."""
    rng = np.random.default_rng(5)
    inputs = np.repeat(commands(10, 4, rate=15.0)[:, None, :], SUBSTEPS, axis=1)
    inputs = inputs + 0.05 * rng.normal(size=inputs.shape)
    free = np.ones_like(inputs)
    free[:, list(held)] = 0.0
    # The pitch rate lags more than the roll rate.
    model.rate_time_constants[1] *= 1.4
    states = rolled_out(start(3), inputs, model)
    A, B = np.zeros((10, STATE_SIZE, STATE_SIZE)), np.zeros((10, STATE_SIZE, 4))
    jacobians(model, STEP, inputs, free, states[0].copy(), states, A, B)

    def next_state(dx: Array, du: Array) -> Array:
        now = states[stage]
        moved = state_of(
            p_WB=now.p_WB + dx[0:3],
            v_WB_W=now.v_WB_W + dx[3:6],
            R_WB=now.R_WB @ so3.exp(dx[6:9]),
            actuators=actuators_of(now) + dx[[12, 9, 10, 11]],
        )
        moved.angular_acceleration[:] = now.angular_acceleration + dx[13:16]
        end = rolled_out(moved, (inputs[stage] + free[stage] * du)[None], model)[1]
        return np.concatenate(
            (
                end.p_WB,
                end.v_WB_W,
                so3.log(states[stage + 1].R_WB.T @ end.R_WB),
                end.w_WB_B,
                [end.throttle],
                end.angular_acceleration,
            )
        )

    h = 1e-6
    zero_x, zero_u = np.zeros(STATE_SIZE), np.zeros(4)
    by_x = [
        (next_state(h * e, zero_u) - next_state(-h * e, zero_u)) / (2 * h)
        for e in np.eye(STATE_SIZE)
    ]
    by_u = [(next_state(zero_x, h * e) - next_state(zero_x, -h * e)) / (2 * h) for e in np.eye(4)]
    np.testing.assert_allclose(A[stage], np.column_stack(by_x), atol=atol)
    np.testing.assert_allclose(B[stage], np.column_stack(by_u), atol=atol)
    return B[stage]


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_jacobians_without_actuators_equal_the_full_ones(vehicle: Vehicle) -> None:
    inputs = np.repeat(commands(3, 4)[:, None, :], SUBSTEPS, axis=1)
    model, free = model_of((0.0, 0.0, 0.0), vehicle=vehicle), np.ones_like(inputs)
    states = rolled_out(start(3), inputs, model)
    found = []
    for size in (9, STATE_SIZE):
        A, B = np.zeros((3, size, size)), np.zeros((3, size, 4))
        jacobians(model, STEP, inputs, free, states[0].copy(), states, A, B)
        found.append((A[:, :9, :9], B[:, :9]))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])

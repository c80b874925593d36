# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The inputs that hold a reference do hold it, through lags and against disturbances."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.records import changed, state_of

from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model import reference_window
from quad_mpc_ros.control.model.parameters import ModelParameters, parameters_of
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.rollout import SUBSTEPS, StateRecord, roll_out
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.model.target import TargetStage, sample_target
from quad_mpc_ros.control.model.vehicle import ActuatorLags, Vehicle
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer

VEHICLE = Vehicle()
UNEVEN = Vehicle(drag=(0.3, 0.15, 0.45), translational_lift=0.015)
ROTORS = Vehicle(drag=0.1, rotor_drag=(0.4, 0.3, 0.6), translational_lift=0.015)
STEPS, STEP = 10, 0.05
U_MIN, U_MAX = np.array([0.0, -30.0, -30.0, -30.0]), np.array([1.0, 30.0, 30.0, 30.0])
START = 10**9


def eight(
    angular_frequency: float, vehicle: Vehicle = VEHICLE, *, at_ns: int = START
) -> ReferenceWindow:
    """Return a window of a lemniscate, a third of the way into it."""
    config = ReferenceConfig(
        trajectory="lemniscate",
        angular_frequency=angular_frequency,
        drag=vehicle.drag,
        rotor_drag=vehicle.rotor_drag,
        translational_lift=vehicle.translational_lift,
        yaw=0.7,
    )
    server = ReferenceServer(config)
    server.start(0)
    return server.window(at_ns)


def model_of(*, rate: float, thrust: float, vehicle: Vehicle = VEHICLE) -> ModelParameters:
    lags = (rate, 0.8 * rate, 1.2 * rate)
    return parameters_of(vehicle, ActuatorLags(rate=lags, thrust=thrust))[()]


def target_of(
    window: ReferenceWindow,
    model: ModelParameters,
    *,
    u_min: Array = U_MIN,
    u_max: Array = U_MAX,
    speeds: Array | None = None,
) -> RecordArray[TargetStage]:
    target = TargetStage.zeros(STEPS)
    sample_target(
        0,
        reference_window.packed(window),
        model,
        STEP,
        u_min=u_min,
        u_max=u_max,
        speeds=np.zeros(0) if speeds is None else speeds,
        target=target,
    )
    return target


def on_reference(
    window: ReferenceWindow, target: RecordArray[TargetStage], model: ModelParameters
) -> StateRecord:
    """Return the state on the reference, actuators included."""
    now = sample(window, window.stamp_ns)
    # What the command of the first substep leads away from at the lag's pace.
    first, second = target[0].inputs[:2]
    lags = np.array([model.thrust_time_constant, *model.rate_time_constants])
    slope = (second - first) / (STEP / SUBSTEPS)
    actuators = first - (lags + 0.5 * STEP / SUBSTEPS) * slope
    return state_of(p_WB=now.p_WB, v_WB_W=now.v_WB_W, R_WB=now.R_WB, actuators=actuators)


def rolled_out(
    model: ModelParameters, target: RecordArray[TargetStage], start: StateRecord
) -> RecordArray[StateRecord]:
    """Return the states 0 to N that the target's inputs lead to."""
    states = StateRecord.zeros(STEPS + 1)
    roll_out(model, STEP, target["inputs"].copy(), start, states)
    return states


@pytest.mark.parametrize("vehicle", [VEHICLE, UNEVEN, ROTORS])
@pytest.mark.parametrize("lags", [(0.0, 0.0), (0.03, 0.03), (0.05, 0.02)])
@pytest.mark.parametrize("angular_frequency", [1.0, 2.2])
def test_target_inputs_hold_a_feasible_reference(
    lags: tuple[float, float], angular_frequency: float, vehicle: Vehicle
) -> None:
    model = model_of(rate=lags[0], thrust=lags[1], vehicle=vehicle)
    window = eight(angular_frequency, vehicle)
    target = target_of(window, model)
    states = rolled_out(model, target, on_reference(window, target, model))[1:]
    # Open loop, with inputs held over 12.5 ms and a guessed start: a centimetre at 9 m/s.
    scale = angular_frequency**4
    np.testing.assert_allclose(states["p_WB"], target["p_WB"], atol=7e-4 * scale)
    np.testing.assert_allclose(states["v_WB_W"], target["v_WB_W"], atol=4e-3 * scale)
    turned = np.swapaxes(target["R_WB"], -1, -2) @ states["R_WB"]
    assert np.abs(so3.log(turned)).max() < 4e-3 * scale


@pytest.mark.parametrize("speed", [0.6, 0.9, 1.1])
def test_target_at_reduced_speed_equals_target_of_slowed_reference(speed: float) -> None:
    """An eight of a lower frequency is the same way in more time, by flatness made for it."""
    model, frequency = model_of(rate=0.03, thrust=0.03), 2.0
    slow = target_of(eight(frequency), model, speeds=np.full(STEPS, speed))
    expected = target_of(eight(frequency * speed, at_ns=round(START / speed)), model)
    np.testing.assert_allclose(slow["p_WB"], expected["p_WB"], atol=2e-4)
    np.testing.assert_allclose(slow["v_WB_W"], expected["v_WB_W"], atol=5e-3)
    np.testing.assert_allclose(slow["R_WB"][..., 2], expected["R_WB"][..., 2], atol=2e-3)
    np.testing.assert_allclose(slow["inputs"][..., 0], expected["inputs"][..., 0], atol=5e-3)
    # The nose points elsewhere, so compare in the world and across the thrust.
    up = expected["R_WB"][:, None, :, 2]
    w_WB_W = [np.einsum("iab,ijb->ija", t["R_WB"], t["inputs"][..., 1:]) for t in (slow, expected)]
    difference = w_WB_W[0] - w_WB_W[1]
    difference -= np.sum(difference * up, axis=-1, keepdims=True) * up
    # The way that the tilt turns is taken to first order.
    assert np.abs(difference).max() < 0.15 * np.abs(w_WB_W[1]).max()


def test_target_compensates_disturbance_by_tilt_and_throttle() -> None:
    """Hovering in wind, with motors weaker than modelled: no acceleration is left."""
    model = changed(model_of(rate=0.0, thrust=0.0), a_W=(1.5, -0.8, 0.3), thrust_scale=0.8)
    server = ReferenceServer(ReferenceConfig(trajectory="hover"))
    server.start(0)
    target = target_of(server.window(START), model)
    states = rolled_out(model, target, state_of(p_WB=target[0].p_WB, R_WB=target[0].R_WB))
    np.testing.assert_allclose(states["v_WB_W"], 0.0, atol=1e-12)
    assert target[0].R_WB[0, 2] < 0.0  # leaning into the wind from the west
    assert target[0].R_WB[1, 2] > 0.0


@pytest.mark.parametrize(
    ("vehicle", "more"), [(VEHICLE, 0.3), (VEHICLE, -0.2), (UNEVEN, 0.3), (ROTORS, 0.3)]
)
def test_target_compensates_learned_drag(vehicle: Vehicle, more: float) -> None:
    """Flown open loop, with attitudes made with the drag that was expected."""
    expected = model_of(rate=0.0, thrust=0.0, vehicle=vehicle)
    factor = 1.0 + more / expected.drag
    model = changed(
        expected,
        drag=factor * expected.drag,
        anisotropic_drag=factor * expected.anisotropic_drag,
        learned_drag=more * (1.0 + expected.anisotropic_drag / expected.drag),
    )
    window = eight(1.0, vehicle)
    target = target_of(window, model)
    now = sample(window, window.stamp_ns)
    unaware = target_of(window, expected)
    tilt = target[0].R_WB @ unaware[0].R_WB.T  # hardly changes within a stage
    aware = rolled_out(
        model, target, state_of(p_WB=now.p_WB, v_WB_W=now.v_WB_W, R_WB=tilt @ now.R_WB)
    )
    blind = rolled_out(model, unaware, on_reference(window, unaware, expected))
    off, off_unaware = (
        np.abs(states["v_WB_W"][1:] - target["v_WB_W"]).max() for states in (aware, blind)
    )
    assert off < 0.2 * off_unaware


def test_inputs_stay_inside_the_bounds_and_means_are_averages() -> None:
    u_max = np.array([0.6, 4.0, 4.0, 4.0])
    target = target_of(eight(2.6), model_of(rate=0.05, thrust=0.05), u_min=-u_max, u_max=u_max)
    assert np.all(np.abs(target["inputs"]) <= u_max)
    assert np.any(np.abs(target["inputs"]) == u_max)
    np.testing.assert_allclose(target["mean_input"], target["inputs"].mean(axis=1), atol=1e-12)

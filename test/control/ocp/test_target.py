"""The inputs that hold a reference do hold it, through lags and against disturbances."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model import reference_window
from quad_mpc_ros.control.model.parameters import (
    ModelParameters,
    packed,
    parameters_in,
    parameters_of,
)
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.rollout import (
    ACTUATORS,
    P_WB,
    R_WB,
    ROW_SIZE,
    SUBSTEPS,
    V_WB_W,
    roll_out,
)
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.ocp.target import Target, sample_target, target_in, target_size
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer

VEHICLE = Vehicle()
UNEVEN = Vehicle(drag=(0.3, 0.15, 0.45), translational_lift=0.015)
ROTORS = Vehicle(drag=0.1, rotor_drag=(0.4, 0.3, 0.6), translational_lift=0.015)
STEPS, STEP = 10, 0.05
U_MIN, U_MAX = np.array([0.0, -30.0, -30.0, -30.0]), np.array([1.0, 30.0, 30.0, 30.0])
START = 10**9


def eight(angular_frequency: float, vehicle: Vehicle = VEHICLE) -> ReferenceWindow:
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
    return server.window(START)


def model_of(*, rate: float, thrust: float, vehicle: Vehicle = VEHICLE) -> ModelParameters:
    lags = (rate, 0.8 * rate, 1.2 * rate)
    return parameters_in(
        parameters_of(vehicle, rate_time_constant=lags, thrust_time_constant=thrust)
    )


def target_of(
    window: ReferenceWindow,
    model: ModelParameters,
    *,
    u_min: Array = U_MIN,
    u_max: Array = U_MAX,
) -> Target:
    buffer = np.zeros(target_size(STEPS))
    sample_target(
        0,
        window.offset_ns,
        reference_window.packed(window),
        packed(model),
        STEP,
        u_min=u_min,
        u_max=u_max,
        buffer=buffer,
    )
    return target_in(buffer)


def row(p_WB: Array, v_WB_W: Array, rotation: Array, actuators: Array) -> Array:
    state = np.zeros(ROW_SIZE)
    state[P_WB], state[V_WB_W] = p_WB, v_WB_W
    state[R_WB], state[ACTUATORS] = rotation.ravel(), actuators
    return state


def on_reference(window: ReferenceWindow, target: Target, model: ModelParameters) -> Array:
    """Return the state on the reference, actuators included."""
    now = sample(window, window.stamp_ns)
    # What the command of the first substep leads away from at the lag's pace.
    first, second = target.inputs[0, 0], target.inputs[0, 1]
    lags = np.array([model.thrust_time_constant, *model.rate_time_constants])
    slope = (second - first) / (STEP / SUBSTEPS)
    actuators = first - (lags + 0.5 * STEP / SUBSTEPS) * slope
    return row(now.p_WB, now.v_WB_W, now.R_WB, actuators)


@pytest.mark.parametrize("vehicle", [VEHICLE, UNEVEN, ROTORS])
@pytest.mark.parametrize("lags", [(0.0, 0.0), (0.03, 0.03), (0.05, 0.02)])
@pytest.mark.parametrize("angular_frequency", [1.0, 2.2])
def test_nothing_needs_to_be_corrected_on_a_reference_that_can_be_flown(
    lags: tuple[float, float], angular_frequency: float, vehicle: Vehicle
) -> None:
    model = model_of(rate=lags[0], thrust=lags[1], vehicle=vehicle)
    window = eight(angular_frequency, vehicle)
    target = target_of(window, model)
    states = np.zeros((STEPS + 1, ROW_SIZE))
    start = on_reference(window, target, model)
    roll_out(model, STEP, target.inputs, start, states)
    # Open loop, with inputs held over 12.5 ms and a guessed start: a centimetre at 9 m/s.
    scale = angular_frequency**4
    np.testing.assert_allclose(states[1:, P_WB], target.p_WB, atol=7e-4 * scale)
    np.testing.assert_allclose(states[1:, V_WB_W], target.v_WB_W, atol=4e-3 * scale)
    turned = np.swapaxes(target.R_WB, -1, -2) @ states[1:, R_WB].reshape(-1, 3, 3)
    assert np.abs(so3.log(turned)).max() < 4e-3 * scale


def test_a_disturbance_is_met_by_tilt_and_throttle() -> None:
    """Hovering in wind, with motors weaker than modelled: no acceleration is left."""
    model = model_of(rate=0.0, thrust=0.0)._replace(a_W=(1.5, -0.8, 0.3), thrust_scale=0.8)
    server = ReferenceServer(ReferenceConfig(trajectory="hover"))
    server.start(0)
    target = target_of(server.window(START), model)
    states = np.zeros((STEPS + 1, ROW_SIZE))
    start = row(target.p_WB[0], np.zeros(3), target.R_WB[0], np.zeros(4))
    roll_out(model, STEP, target.inputs, start, states)
    np.testing.assert_allclose(states[:, V_WB_W], 0.0, atol=1e-12)
    assert target.R_WB[0, 0, 2] < 0.0  # leaning into the wind from the west
    assert target.R_WB[0, 1, 2] > 0.0


@pytest.mark.parametrize(
    ("vehicle", "more"), [(VEHICLE, 0.3), (VEHICLE, -0.2), (UNEVEN, 0.3), (ROTORS, 0.3)]
)
def test_drag_that_the_reference_does_not_know_is_met(vehicle: Vehicle, more: float) -> None:
    """Flown open loop, with attitudes made with the drag that was expected."""
    expected = model_of(rate=0.0, thrust=0.0, vehicle=vehicle)
    factor = 1.0 + more / expected.drag
    model = expected._replace(
        drag=factor * expected.drag,
        uneven_drag=tuple(factor * off for off in expected.uneven_drag),
        learned_drag=tuple(more * (1.0 + off / expected.drag) for off in expected.uneven_drag),
    )
    window = eight(1.0, vehicle)
    target = target_of(window, model)
    states = np.zeros((STEPS + 1, ROW_SIZE))
    now = sample(window, window.stamp_ns)
    unaware = target_of(window, expected)
    tilt = target.R_WB[0] @ unaware.R_WB[0].T  # hardly changes within a stage
    start = row(now.p_WB, now.v_WB_W, tilt @ now.R_WB.reshape(3, 3), np.zeros(4))
    roll_out(model, STEP, target.inputs, start, states)
    off = np.abs(states[1:, V_WB_W] - target.v_WB_W).max()
    roll_out(model, STEP, unaware.inputs, on_reference(window, unaware, expected), states)
    assert off < 0.2 * np.abs(states[1:, V_WB_W] - target.v_WB_W).max()


def test_at_rest_the_throttle_is_that_of_hovering() -> None:
    model = model_of(rate=0.03, thrust=0.03)
    server = ReferenceServer(ReferenceConfig(trajectory="hover"))
    server.start(0)
    target = target_of(server.window(START), model)
    np.testing.assert_allclose(target.inputs[..., 0], 0.2923008, atol=1e-7)
    np.testing.assert_array_equal(target.inputs[..., 1:], 0.0)


def test_inputs_stay_inside_the_bounds_and_means_are_means() -> None:
    u_max = np.array([0.6, 4.0, 4.0, 4.0])
    target = target_of(eight(2.6), model_of(rate=0.05, thrust=0.05), u_min=-u_max, u_max=u_max)
    assert np.all(np.abs(target.inputs) <= u_max)
    assert np.any(np.abs(target.inputs) == u_max)
    np.testing.assert_allclose(target.mean_inputs, target.inputs.mean(axis=1), atol=1e-12)

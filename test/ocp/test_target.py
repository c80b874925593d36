"""The inputs that hold a reference do hold it, through lags and against disturbances."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.lie import so3
from quad_mpc_ros.model.reference_window import sample
from quad_mpc_ros.model.rollout import (
    NO_DISTURBANCE,
    SUBSTEPS,
    Disturbance,
    Model,
    Motion,
    model_of,
    motion,
    roll_out,
)
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.model.vehicle import Vehicle
from quad_mpc_ros.ocp.target import Target, TargetSampler
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.server import ReferenceServer

VEHICLE = Vehicle()
STEPS, STEP = 10, 0.05
U_MIN, U_MAX = np.array([0.0, -30.0, -30.0, -30.0]), np.array([1.0, 30.0, 30.0, 30.0])
START = 10**9


def eight(angular_frequency: float) -> ReferenceWindow:
    """Return a window of a lemniscate, a third of the way into it."""
    config = ReferenceConfig(trajectory="lemniscate", angular_frequency=angular_frequency)
    server = ReferenceServer(config)
    server.start(0)
    return server.window(START)


def target_of(
    window: ReferenceWindow, model: Model, disturbance: Disturbance = NO_DISTURBANCE
) -> Target:
    sampler = TargetSampler(steps=STEPS, substeps=SUBSTEPS, step=STEP)
    return sampler.sample(
        window, window.stamp_ns, model=model, disturbance=disturbance, u_min=U_MIN, u_max=U_MAX
    )


def on_reference(window: ReferenceWindow, target: Target, model: Model) -> Motion:
    """Return the state on the reference, actuators included."""
    now = sample(window, window.stamp_ns)
    # What the command of the first substep leads away from at the lag's pace.
    first, second = target.inputs[0, 0], target.inputs[0, 1]
    lags = np.array([model.thrust_time_constant, *[model.rate_time_constant] * 3])
    slope = (second - first) / (STEP / SUBSTEPS)
    actuators = first - (lags + 0.5 * STEP / SUBSTEPS) * slope
    return Motion(now.p_WB[None], now.v_WB_W[None], now.R_WB[None], actuators[None])


@pytest.mark.parametrize("lags", [(0.0, 0.0), (0.03, 0.03), (0.05, 0.02)])
@pytest.mark.parametrize("angular_frequency", [1.0, 2.2])
def test_nothing_needs_to_be_corrected_on_a_reference_that_can_be_flown(
    lags: tuple[float, float], angular_frequency: float
) -> None:
    model = model_of(VEHICLE, rate_time_constant=lags[0], thrust_time_constant=lags[1])
    window = eight(angular_frequency)
    target = target_of(window, model)
    states = motion(STEPS + 1)
    start = on_reference(window, target, model)
    roll_out(model, STEP, np.zeros(3), 1.0, target.inputs, start, states)
    # Open loop, with inputs held over 12.5 ms and a guessed start: a centimetre at 9 m/s.
    scale = angular_frequency**4
    np.testing.assert_allclose(states.p_WB[1:], target.p_WB, atol=7e-4 * scale)
    np.testing.assert_allclose(states.v_WB_W[1:], target.v_WB_W, atol=4e-3 * scale)
    turned = np.swapaxes(target.R_WB, -1, -2) @ states.R_WB[1:]
    assert np.abs(so3.log(turned)).max() < 4e-3 * scale


def test_a_disturbance_is_met_by_tilt_and_throttle() -> None:
    """Hovering in wind, with motors weaker than modelled: no acceleration is left."""
    model = model_of(VEHICLE, rate_time_constant=0.0, thrust_time_constant=0.0)
    disturbance = Disturbance(a_W=np.array([1.5, -0.8, 0.3]), thrust_scale=0.8)
    server = ReferenceServer(ReferenceConfig(trajectory="hover"))
    server.start(0)
    target = target_of(server.window(START), model, disturbance)
    states = motion(STEPS + 1)
    start = Motion(target.p_WB[:1], np.zeros((1, 3)), target.R_WB[:1], np.zeros((1, 4)))
    roll_out(
        model,
        STEP,
        disturbance.a_W,
        disturbance.thrust_scale,
        target.inputs,
        start,
        states,
    )
    np.testing.assert_allclose(states.v_WB_W, 0.0, atol=1e-12)
    assert target.R_WB[0, 0, 2] < 0.0  # leaning into the wind from the west
    assert target.R_WB[0, 1, 2] > 0.0


def test_at_rest_the_throttle_is_that_of_hovering() -> None:
    model = model_of(VEHICLE, rate_time_constant=0.03, thrust_time_constant=0.03)
    server = ReferenceServer(ReferenceConfig(trajectory="hover"))
    server.start(0)
    target = target_of(server.window(START), model)
    np.testing.assert_allclose(target.inputs[..., 0], 0.2923008, atol=1e-7)
    np.testing.assert_array_equal(target.inputs[..., 1:], 0.0)


def test_inputs_stay_inside_the_bounds_and_means_are_means() -> None:
    model = model_of(VEHICLE, rate_time_constant=0.05, thrust_time_constant=0.05)
    sampler = TargetSampler(steps=STEPS, substeps=SUBSTEPS, step=STEP)
    u_max = np.array([0.6, 4.0, 4.0, 4.0])
    target = sampler.sample(
        eight(2.6), START, model=model, disturbance=NO_DISTURBANCE, u_min=-u_max, u_max=u_max
    )
    assert np.all(np.abs(target.inputs) <= u_max)
    assert np.any(np.abs(target.inputs) == u_max)
    np.testing.assert_allclose(target.mean_inputs, target.inputs.mean(axis=1), atol=1e-12)

"""The model's derivatives by its parameters against finite differences through ⊞ and ⊟."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.records import changed

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.parameter_jacobians import (
    BY,
    MotionDerivatives,
    at_start,
    followed_loop,
    no_motion,
    propagated_with_derivatives,
)
from quad_mpc_ros.control.model.parameters import ModelParameters, parameters_of
from quad_mpc_ros.control.model.rollout import Body, propagated
from quad_mpc_ros.control.model.state import State, boxminus
from quad_mpc_ros.control.model.vehicle import ActuatorLags, Vehicle

COMMANDS = ((0.5, 1.0, -2.0, 0.7), (0.2, 1.0, -2.0, 0.7))
DURATIONS = (0.013, 0.021)
FALLING = 1.6  # time constant of a falling throttle over that of a rising one
AIR = {
    "even": Vehicle(drag=0.3),
    "uneven": Vehicle(drag=(0.1, 0.3, 0.6)),
    "rotors": Vehicle(drag=(0.1, 0.3, 0.6), rotor_drag=(0.3, 0.4, 0.1), translational_lift=0.02),
}


def model_of(vehicle: Vehicle) -> ModelParameters:
    model = parameters_of(
        vehicle, ActuatorLags(rate=0.0, thrust=0.04, thrust_down=FALLING * 0.04)
    )[()]
    return changed(model, thrust_scale=0.9, a_W=np.array([0.7, -0.4, 0.3]))


def start(*, v_W: Array | None = None, throttle: float = 0.35) -> Body:
    v = np.array([6.0, -4.0, 2.0]) if v_W is None else v_W
    R = so3.exp([0.3, -0.5, 0.2])
    return Body(
        (1.0, 2.0, 3.0), tuple(v), tuple(R.ravel()), (throttle, 1.0, -2.0, 0.7), (0.0, 0.0, 0.0)
    )


def flown(model: ModelParameters, x: Body) -> Body:
    for command, duration in zip(COMMANDS, DURATIONS, strict=True):
        x = propagated(model, command, duration, x)
    return x


def difference(after: Body, before: Body) -> Array:
    """Return after ⊟ before, velocity in the world, and throttle: (10,)."""

    def of(x: Body) -> State:
        R = np.array(x.R).reshape(3, 3)
        return State(p_WB=np.array(x.p), v_WB_B=R.T @ np.array(x.v), R_WB=R)

    tangent = boxminus(of(after), of(before))
    tangent[3:6] = np.subtract(after.v, before.v)
    return np.array([*tangent, after.actuators[0] - before.actuators[0]])


def with_drag(model: ModelParameters, drag: float) -> ModelParameters:
    return changed(model, drag=drag, anisotropic_drag=drag / model.drag * model.anisotropic_drag)


def by_number(name: str) -> Callable[[ModelParameters, float], ModelParameters]:
    return lambda model, by: changed(model, **{name: float(model[name]) + by})  # type: ignore[index]


def by_lag(model: ModelParameters, by: float) -> ModelParameters:
    """Both time constants of the thrust change in proportion."""
    lag = float(model.thrust_time_constant) + by
    return changed(model, thrust_time_constant=lag, thrust_time_constant_down=FALLING * lag)


def pushed(k: int) -> Callable[[ModelParameters, float], ModelParameters]:
    return lambda model, by: changed(model, a_W=model.a_W + by * np.eye(3)[k])


PARAMETERS: dict[int, Any] = {
    **{BY.disturbance + k: pushed(k) for k in range(3)},
    BY.scale: by_number("thrust_scale"),
    BY.lag: by_lag,
    BY.drag: lambda model, by: with_drag(model, float(model.drag) + by),
}


def derivatives(model: ModelParameters, x: Body) -> MotionDerivatives:
    found = no_motion()
    shape = tuple(model.anisotropic_drag / model.drag)
    for command, duration in zip(COMMANDS, DURATIONS, strict=True):
        x = propagated_with_derivatives(model, shape, command, duration, x, found)
    np.testing.assert_array_equal(difference(x, flown(model, start())), 0.0)
    return found


@pytest.mark.parametrize("air", AIR)
def test_derivatives_equal_finite_differences_through_box_minus(air: str) -> None:
    model, step = model_of(AIR[air]), 1e-5
    found = derivatives(model, start())
    for column in range(BY.size):
        ends = []
        for by in (step, -step):
            if column in PARAMETERS:
                ends.append(flown(PARAMETERS[column](model, by), start()))
            elif column == BY.throttle:
                ends.append(flown(model, start(throttle=0.35 + by)))
            else:
                moved = np.array([6.0, -4.0, 2.0]) + by * np.eye(3)[column - BY.velocity]
                ends.append(flown(model, start(v_W=moved)))
        slopes = difference(*ends) / (2.0 * step)
        expected = np.concatenate((slopes[:6], slopes[-1:]))
        ours = np.array([*found.p[column], *found.v[column], found.s[column]])
        np.testing.assert_allclose(ours, expected, rtol=2e-6, atol=2e-9, err_msg=str(column))
        np.testing.assert_allclose(slopes[6:9], 0.0, atol=1e-9)  # nothing turns


@pytest.mark.parametrize("lags", [(0.03, 0.0), (0.04, 0.15), (0.3, 0.1)])
def test_derivatives_of_a_rate_loop_equal_finite_differences(lags: tuple[float, float]) -> None:
    def end(at: Array) -> tuple[Array, Array]:
        x, D = (at[0], at[1]), at_start()
        now = lags[0] * np.exp(at[2]), lags[1] * np.exp(at[3])
        for command, thrust, duration in zip((1.0, -2.0), (9.0, 12.0), DURATIONS, strict=True):
            follows = command + at[4] + at[5] * thrust
            x = followed_loop(now, (follows, thrust), duration, x, D)
        return np.array(x), D

    step, at = 1e-5, np.array([0.4, 7.0, 0.0, 0.0, 0.1, 0.02])
    found = end(at)[1]
    for k, slope in enumerate(found.T):
        up, down = (end(at + by * np.eye(6)[k])[0] for by in (step, -step))
        np.testing.assert_allclose(slope, (up - down) / (2.0 * step), rtol=1e-4, atol=1e-5)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The measurement model of the accelerometer: Jacobian, physical cases, and estimates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fixtures.records import changed, state_of

from quad_mpc_ros.control.estimation import ekf, kalman
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.ekf import VehicleEkf
from quad_mpc_ros.control.estimation.filter_state import MOTION, Filter
from quad_mpc_ros.control.estimation.specific_force import SpecificForces, force_innovation
from quad_mpc_ros.control.estimation.translation_update import predict_translation
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.parameters import parameters_of
from quad_mpc_ros.control.model.rollout import Body, StateRecord, propagated
from quad_mpc_ros.control.model.samples import ImuSample
from quad_mpc_ros.control.model.vehicle import ActuatorLags, Vehicle

PERIOD = 0.02
VEHICLE = Vehicle(drag=(0.2, 0.3, 0.4), rotor_drag=(0.1, 0.1, 0.05), translational_lift=0.01)
NOMINAL = parameters_of(VEHICLE, ActuatorLags(rate=0.0, thrust=0.04))[()]
HOVER, GRAVITY = VEHICLE.hover_throttle, VEHICLE.gravity
LEVEL = np.eye(3)


def state_at(**values: float | Array) -> Array:
    """Return a state of the motion (n,): at rest in hover, but for some of it."""
    x = np.zeros(MOTION.size)
    x[MOTION.scale], x[MOTION.lag], x[MOTION.drag] = 1.0, 0.04, NOMINAL.drag
    x[MOTION.throttle] = HOVER
    for name, value in values.items():
        begin = getattr(MOTION, name)
        x[begin : begin + np.size(value)] = value
    return x


def innovation_of(
    x: Array, *, f_B: Array, throttle: float = HOVER, R_before: Array = LEVEL, turn: Array
) -> kalman.Innovation:
    """Return the innovation of a measurement at a state, under a throttle, while it turns."""
    state = Filter.zeros()[()]
    state.nominal = state.estimated = NOMINAL
    state.drag_shape[:] = NOMINAL.anisotropic_drag / NOMINAL.drag
    state.translation.x[:] = x
    before, after = state_of(R_WB=R_before), state_of(R_WB=R_before @ so3.exp(turn))
    acting = Acting(
        durations=np.array([0.4 * PERIOD, 0.6 * PERIOD]),
        commands=np.array([[throttle, 0.0, 0.0, 0.0], [throttle + 0.1, 0.0, 0.0, 0.0]]),
    )
    if throttle == HOVER:
        acting.commands[:, 0] = HOVER
    F, force = predict_translation(state, acting, before, after, True), state.specific_force
    force.f_B[:], force.variance = f_B, 0.25
    later, P = np.array(state.translation.x), np.eye(MOTION.size)
    return force_innovation(x, P, F, later, (before, after), PERIOD, GRAVITY, force)


STILL = np.zeros(3)
MOVING = state_at(
    velocity=np.array([3.0, -2.0, 1.0]),
    disturbance=np.array([0.5, -0.3, 0.2]),
    scale=0.9,
    drag=0.35,
    throttle=0.35,
    accelerometer=np.array([0.1, -0.2, 0.3]),
)


def test_jacobian_matches_finite_differences() -> None:
    """Every state is tested; with a covariance of one, P H' is the Jacobian's transpose."""
    arguments = {"throttle": 0.4, "R_before": so3.exp([0.3, -0.5, 1.0]), "turn": np.full(3, 0.1)}
    seen = innovation_of(MOVING, f_B=STILL, **arguments)
    step = 1e-6
    for i in range(MOTION.size):
        off = np.zeros(MOTION.size)
        off[i] = step
        ahead = innovation_of(MOVING + off, f_B=STILL, **arguments)
        behind = innovation_of(MOVING - off, f_B=STILL, **arguments)
        slope = -(ahead.nu - behind.nu) / (2.0 * step)
        np.testing.assert_allclose(seen.PHt[i], slope, rtol=1e-4, atol=1e-6, err_msg=str(i))
    np.testing.assert_allclose(seen.S, seen.PHt.T @ seen.PHt + 0.25 * np.eye(3), atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, 1.0])
@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_hover_thrust_measures_gravity_along_the_thrust_at_any_tilt(
    yaw: float, tilt: float
) -> None:
    R_WB = so3.exp([0.0, 0.0, yaw]) @ so3.exp([0.0, tilt, 0.0])
    seen = innovation_of(state_at(), f_B=np.array([0.0, 0.0, GRAVITY]), R_before=R_WB, turn=STILL)
    # Drag of what falling aside makes of the velocity in 20 ms.
    np.testing.assert_allclose(seen.nu, 0.0, atol=0.03)


def test_free_fall_measures_zero_and_wind_its_disturbance() -> None:
    falling = state_at(throttle=0.0, scale=1e-9)
    np.testing.assert_allclose(innovation_of(falling, f_B=STILL, turn=STILL).nu, 0.0, atol=0.05)
    pushed = state_at(disturbance=np.array([1.0, 0.0, 0.0]))
    north = so3.exp([0.0, 0.0, 0.5 * math.pi])  # the body's y axis points west
    f_B = np.array([0.0, -1.0, GRAVITY])
    np.testing.assert_allclose(
        innovation_of(pushed, f_B=f_B, R_before=north, turn=STILL).nu, 0.0, atol=0.03
    )


def test_predicts_drag_against_the_motion() -> None:
    forwards = state_at(velocity=np.array([5.0, 0.0, 0.0]))
    seen = innovation_of(forwards, f_B=np.array([0.0, 0.0, GRAVITY]), turn=STILL)
    expected = 5.0 * (0.2 + 0.1)  # of the body, and of rotors at the speed of hover
    assert seen.nu[0] == pytest.approx(expected, rel=0.02)


def test_averages_samples_between_two_odometries() -> None:
    forces = SpecificForces()
    for stamp_ns, up in ((10, 1.0), (15, 2.0), (20, 4.0), (25, 8.0)):
        forces.add(ImuSample(stamp_ns=stamp_ns, f_B=[0.0, 0.0, up]))
    np.testing.assert_array_equal(forces.mean(start_ns=10, end_ns=20), [0.0, 0.0, 3.0])
    assert forces.mean(start_ns=10, end_ns=20) is None
    np.testing.assert_array_equal(forces.mean(start_ns=20, end_ns=40), [0.0, 0.0, 8.0])
    forces.add(ImuSample(stamp_ns=50, f_B=[0.0, 0.0, 1.0]))
    forces.add(ImuSample(stamp_ns=3, f_B=[0.0, 0.0, 5.0]))  # of a clock that was set
    np.testing.assert_array_equal(forces.mean(start_ns=0, end_ns=60), [0.0, 0.0, 5.0])


class Flown:
    """A filter that follows a hovering vehicle, whose velocity is noisy, with an accelerometer."""

    def __init__(
        self, *, uses_accelerometer: bool, scale: float = 1.0, bias: Array = STILL
    ) -> None:
        self.state = Filter.zeros()[()]
        self.ekf = VehicleEkf(
            NOMINAL,
            throttle=HOVER,
            delay=0.1,
            uses_accelerometer=uses_accelerometer,
            state=self.state,
        )
        self._uses_accelerometer, self._bias, self._rng = (
            uses_accelerometer,
            bias,
            np.random.default_rng(3),
        )
        self._model = changed(NOMINAL, thrust_scale=scale)
        self._body = Body(
            (0.0,) * 3, (0.0,) * 3, tuple(LEVEL.ravel()), (HOVER, 0.0, 0.0, 0.0), (0.0,) * 3
        )
        self._measured = self._odometry()
        self.ekf.start(p_WB=STILL, v_WB_W=STILL, w_WB_B=STILL)

    def go_on(self, seconds: float, *, force: Array = STILL) -> None:
        """Fly on about hover; ``force`` [m/s^2] is measured and moves nothing."""
        for k in range(round(seconds / PERIOD)):
            throttle = HOVER / math.sqrt(self._model.thrust_scale)
            command = (throttle + 0.02 * math.sin(3.0 * k * PERIOD), 0.0, 0.0, 0.0)
            v = np.array(self._body.v)
            self._body = propagated(self._model, command, PERIOD, self._body)
            f_B = (np.array(self._body.v) - v) / PERIOD + [0.0, 0.0, GRAVITY]
            self.state.specific_force.f_B[:] = (
                f_B + self._bias + force + 0.1 * self._rng.normal(size=3)
            )
            self.state.specific_force.variance = 0.25 if self._uses_accelerometer else 0.0
            before, self._measured = self._measured, self._odometry()
            acting = Acting(durations=np.array([PERIOD]), commands=np.array([command]))
            mode = ekf.update(self.state, before, self._measured, acting, UpdateMode.LEARN, 0.0)
            # At first the noise of the velocity is not known yet.
            assert mode in (UpdateMode.LEARN, UpdateMode.REJECT)

    def _odometry(self) -> StateRecord:
        noisy = np.array(self._body.v) + 0.3 * self._rng.normal(size=3)
        return state_of(
            p_WB=np.array(self._body.p) + 0.01 * self._rng.normal(size=3), v_WB_W=noisy
        )

    def lift_error(self) -> float:
        """How far the estimated lift is off the true one, at hover [m/s^2]."""
        found, scale = self.ekf.parameters(), float(self._model.thrust_scale)
        throttle = HOVER / math.sqrt(scale)
        lift = NOMINAL.a * throttle**2
        return abs(float(found.thrust_scale - scale) * lift + float(found.a_W[2]))


def test_accelerometer_speeds_up_the_thrust_estimate() -> None:
    errors = {}
    for uses_accelerometer in (False, True):
        flown = Flown(uses_accelerometer=uses_accelerometer, scale=0.8)
        flown.go_on(0.3)
        errors[uses_accelerometer] = flown.lift_error()
    assert errors[True] < 0.5 * errors[False]


def test_distinguishes_bias_from_wind() -> None:
    """The velocity shows no wind."""
    bias = np.array([0.2, -0.2, 0.2])
    flown = Flown(uses_accelerometer=True, bias=bias)
    flown.go_on(20.0)
    np.testing.assert_allclose(flown.state.translation.x[MOTION.accelerometer :], bias, atol=0.06)
    np.testing.assert_allclose(flown.ekf.parameters().a_W[:2], 0.0, atol=0.1)
    flown.ekf.start_over()
    assert not flown.state.translation.x[MOTION.accelerometer :].any()


def test_the_innovation_gate_rejects_contradicting_measurements() -> None:
    """A sensor mounted upside down."""
    flown = Flown(uses_accelerometer=True)
    flown.go_on(2.0)
    assert flown.state.specific_force.used
    flown.go_on(1.0, force=np.array([0.0, 0.0, -2.0 * GRAVITY]))
    assert not flown.state.specific_force.used and flown.state.specific_force.nis > kalman.GATE
    assert flown.lift_error() < 0.2

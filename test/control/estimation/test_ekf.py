# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameters that the filter estimates from exact motions, and those it must not change."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from fixtures.plant_motion import integrate
from fixtures.records import numbers, state_of
from numpy.typing import ArrayLike

from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.ekf import VehicleEkf, update
from quad_mpc_ros.control.estimation.filter_state import MOTION, Filter, is_at_bounds
from quad_mpc_ros.control.estimation.update_mode import UpdateMode, update_mode
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.parameters import ModelParameters, parameters_of
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.control.model.vehicle import ActuatorLags, Vehicle

VEHICLE = Vehicle()
PERIOD, FINE = 0.02, 10
HOVER = VEHICLE.hover_throttle
REST = (0.0, 0.0, 0.0)


def parameters(
    *, rate: float = 0.0, thrust: float = 0.0, vehicle: Vehicle = VEHICLE
) -> ModelParameters:
    return parameters_of(vehicle, ActuatorLags(rate=rate, thrust=thrust))[()]


class Ekf(VehicleEkf):
    """The filter, and its last measurement."""

    def __init__(self, nominal: ModelParameters, *, throttle: float, delay: float = 0.1) -> None:
        self.state = Filter.zeros()[()]
        self._last = measured(p_WB=np.zeros(3))
        super().__init__(nominal, throttle=throttle, delay=delay, state=self.state)

    def begin(self, v_WB_W: Array) -> None:
        """Begin at the origin."""
        self._last = measured(p_WB=np.zeros(3), v_WB_W=v_WB_W)
        self.start(p_WB=np.zeros(3), v_WB_W=v_WB_W, w_WB_B=np.zeros(3))

    def update(
        self,
        after: StateRecord,
        u: Input | None = None,
        *,
        before: StateRecord | None = None,
        permitted: UpdateMode = UpdateMode.LEARN,
    ) -> UpdateMode:
        """Update under a command, by default that of hover.

        Position and velocity before are those of the last call; ``before`` adds attitude and
        rates. An unknown position after follows from the velocities.
        """
        before = measured() if before is None else before
        last, self._last = self._last, after
        before.p_WB[:], before.v_WB_W[:] = last.p_WB, last.v_WB_W
        if np.isnan(after.p_WB[0]):
            after.p_WB[:] = last.p_WB + 0.5 * PERIOD * (last.v_WB_W + after.v_WB_W)
        command = (u or Input(throttle=HOVER, w_WB_B=np.zeros(3))).vector()
        acting = Acting(durations=np.array([PERIOD]), commands=command[None])
        return update(self.state, before, after, acting, permitted, 0.0)


def measured(
    *,
    rotation: Array | None = None,
    w_WB_B: ArrayLike = REST,
    v_WB_W: ArrayLike = REST,
    p_WB: ArrayLike = (np.nan, np.nan, np.nan),
) -> StateRecord:
    """Return the state of an odometry, by default at rest and level."""
    actuators = [0.0, *np.asarray(w_WB_B)]
    return state_of(p_WB=p_WB, R_WB=rotation, v_WB_W=v_WB_W, actuators=actuators)


def command(seconds: float) -> Input:
    """Return a command of a vehicle that oscillates about hover."""
    return Input(
        throttle=0.29 + 0.12 * np.sin(7.0 * seconds) + 0.1 * np.sin(3.1 * seconds),
        w_WB_B=np.array(
            [
                2.0 * np.cos(4.0 * seconds),
                1.5 * np.cos(2.6 * seconds) + np.sin(9.0 * seconds),
                np.sin(5.0 * seconds),
            ]
        ),
    )


def flown(
    ekf: Ekf,
    *,
    rate: float = 0.0,
    thrust: float = 0.0,
    slower_yaw: float = 1.0,
    scale: float = 1.0,
    a_W: Array | None = None,
    frozen: bool = False,
    noise: float = 0.0,
    drag: float = VEHICLE.drag,
) -> Ekf:
    """Update the filter in a flight, integrated in fine steps by the true rigid body."""
    rng = np.random.default_rng(3)
    x = State(p_WB=np.zeros(3), v_WB_B=np.zeros(3), R_WB=np.eye(3))
    acting = np.concatenate(([0.29], np.zeros(3)))
    lags = np.array([thrust, rate, rate, slower_yaw * rate])
    ekf.begin(x.v_WB_W)
    for k in range(500):
        u, before, w_before = command(k * PERIOD), x, acting[1:].copy()
        for _ in range(FINE):
            dt = PERIOD / FINE
            decay = np.exp(-dt / np.maximum(lags, 1e-12))
            half = np.sqrt(decay)
            acting, middle = (
                u.vector() + decay * (acting - u.vector()),
                u.vector() + half * (acting - u.vector()),
            )
            # A stronger thrust is one more of the motors' curve.
            s = middle[0]
            force = scale * VEHICLE.thrust(s)
            held = Input(throttle=VEHICLE.throttle_for(force), w_WB_B=middle[1:])
            x = integrate(x, held, dataclasses.replace(VEHICLE, drag=drag), duration=dt)
            if a_W is not None:
                pushed = x.v_WB_W + dt * a_W
                x = State(p_WB=x.p_WB, v_WB_B=x.R_WB.T @ pushed, R_WB=x.R_WB)
        ekf.update(
            before=measured(rotation=before.R_WB, w_WB_B=w_before),
            after=measured(
                rotation=x.R_WB,
                w_WB_B=acting[1:] + noise * rng.normal(size=3),
                v_WB_W=x.v_WB_W + noise * rng.normal(size=3),
                p_WB=x.p_WB,
            ),
            u=u,
            permitted=UpdateMode.HOLD if frozen else UpdateMode.LEARN,
        )
    return ekf


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.1])
def test_separates_wind_from_thrust_scale(scale: float) -> None:
    wind = np.array([0.6, -0.4, 0.2])
    ekf = Ekf(parameters(), throttle=0.29)
    estimate = flown(ekf, scale=scale, a_W=wind).parameters()
    np.testing.assert_allclose(estimate.a_W[:2], wind[:2], atol=0.1)
    # It sinks all the while: an updraught is like more drag.
    np.testing.assert_allclose(estimate.a_W[2], wind[2], atol=0.2)
    assert estimate.thrust_scale == pytest.approx(scale, abs=0.01)


@pytest.mark.parametrize(("rate", "thrust"), [(0.03, 0.03), (0.045, 0.045), (0.02, 0.055)])
def test_estimates_time_constants(rate: float, thrust: float) -> None:
    ekf = Ekf(parameters(rate=0.03, thrust=0.03), throttle=0.29)
    learned = flown(ekf, rate=rate, thrust=thrust, scale=0.9).parameters()
    assert learned.rate_time_constants[0] == pytest.approx(rate, rel=0.02)
    assert learned.thrust_time_constant == pytest.approx(thrust, rel=0.1)
    assert ekf.parameters().thrust_scale == pytest.approx(0.9, abs=0.02)
    assert ekf.state.translation.x[MOTION.throttle] == pytest.approx(_lagging(thrust), abs=0.01)


@pytest.mark.parametrize("slower", [1.0, 2.5, 4.0])
def test_slow_yaw_does_not_bias_roll_and_pitch(slower: float) -> None:
    ekf = Ekf(parameters(rate=0.03, thrust=0.03), throttle=0.29)
    learned = flown(ekf, rate=0.04, thrust=0.03, slower_yaw=slower).parameters()
    assert learned.rate_time_constants[0] == pytest.approx(0.04, rel=0.02)
    assert learned.rate_time_constants[2] == pytest.approx(slower * 0.04, rel=0.05)


def test_noise_reduces_only_the_accuracy() -> None:
    ekf = Ekf(parameters(rate=0.03, thrust=0.03), throttle=0.29)
    learned = flown(ekf, rate=0.045, thrust=0.045, noise=0.03).parameters()
    assert learned.rate_time_constants[0] == pytest.approx(0.045, rel=0.1)
    assert learned.thrust_time_constant == pytest.approx(0.045, rel=0.3)


def test_zero_lags_are_not_estimated() -> None:
    ekf = Ekf(parameters(), throttle=0.29)
    learned = flown(ekf, rate=0.02, thrust=0.02).parameters()
    assert learned.thrust_time_constant == 0.0
    np.testing.assert_array_equal(learned.rate_time_constants, 0.0)


@pytest.mark.parametrize("drag", [0.0, 0.45, 0.7])
def test_separates_drag_from_wind(drag: float) -> None:
    wind = np.array([0.6, -0.4, 0.2])
    learned = flown(Ekf(parameters(), throttle=0.29), drag=drag, a_W=wind, scale=0.9).parameters()
    assert learned.drag == pytest.approx(drag, abs=0.05)
    np.testing.assert_allclose(learned.learned_drag, learned.drag - VEHICLE.drag, atol=1e-12)
    np.testing.assert_allclose(learned.a_W[:2], wind[:2], atol=0.25)


def test_estimated_drag_keeps_the_ratios_of_the_axes() -> None:
    modelled = Vehicle(drag=(0.1, 0.3, 0.5))
    ekf = Ekf(parameters(vehicle=modelled), throttle=0.29)
    # The same air along all axes is as much as this on average, as far as its motion shows.
    learned = flown(ekf, drag=0.6).parameters()
    along = np.add(learned.drag, learned.anisotropic_drag)
    np.testing.assert_allclose(along / learned.drag, [1.0 / 3.0, 1.0, 5.0 / 3.0])
    np.testing.assert_allclose(along - learned.learned_drag, modelled.drag)


def test_learns_no_drag_at_rest() -> None:
    ekf = Ekf(parameters(), throttle=0.29)
    rng = np.random.default_rng(5)
    for velocity in 0.1 * rng.normal(size=(500, 3)):
        ekf.update(measured(v_WB_W=velocity))
    assert ekf.parameters().drag == VEHICLE.drag


@pytest.mark.parametrize(
    ("lag", "delay", "scale"), [(0.06, 0.02, 1), (0.02, 0.01, 4), (0.02, 0.0, 4)]
)
def test_fast_vehicle_is_estimated_faster(lag: float, delay: float, scale: float) -> None:
    push = 2.0
    ekf = Ekf(parameters(rate=lag, thrust=lag), throttle=HOVER, delay=delay)
    speed, drag = 0.0, VEHICLE.drag
    for k in range(115):
        pushed = push if k >= 100 else 0.0
        speed += PERIOD * (pushed - drag * speed)
        ekf.update(measured(v_WB_W=np.array([speed, 0.0, 0.0])))
    found = ekf.parameters().a_W[0] / push
    assert 0.85 < found < 1.15 if scale > 1 else found < 0.8


def test_held_estimate_does_not_change() -> None:
    modelled = parameters(rate=0.03, thrust=0.03)
    ekf = Ekf(modelled, throttle=0.29)
    flown(ekf, rate=0.05, thrust=0.05, scale=0.8, frozen=True)
    np.testing.assert_array_equal(numbers(ekf.parameters()), numbers(modelled))


def test_recall_restores_estimate_and_keeps_velocity() -> None:
    ekf = Ekf(parameters(rate=0.03, thrust=0.03), throttle=0.29)
    flown(ekf, rate=0.03, thrust=0.03, a_W=np.array([0.6, -0.4, 0.2]))
    before = ekf.parameters()
    ekf.keep(0)
    idle = Input(throttle=0.1, w_WB_B=np.zeros(3))
    for _ in range(50):  # what carries it is not the thrust
        ekf.update(measured(), idle)
    assert np.abs(ekf.parameters().a_W).max() > 2.0
    ekf.restore()
    np.testing.assert_array_equal(numbers(ekf.parameters()), numbers(before))
    flown(ekf, rate=0.03, thrust=0.03, a_W=np.array([0.6, -0.4, 0.2]))
    np.testing.assert_allclose(ekf.parameters().a_W, [0.6, -0.4, 0.2], atol=0.1)


def hovering(ekf: Ekf, *, scale: float, seconds: float) -> list[ModelParameters]:
    """Return the estimates of a vehicle that a controller holds in place by them.

    The thrust is ``scale`` times the modelled; the velocity goes with what is left of the error.
    """
    ekf.begin(np.zeros(3))
    velocity, found = 0.0, []
    for _ in range(round(seconds / PERIOD)):
        learned = ekf.parameters()
        wanted = VEHICLE.gravity - learned.a_W[2] - 2.0 * velocity
        throttle = VEHICLE.throttle_for(VEHICLE.mass * wanted / learned.thrust_scale)
        force = scale * wanted / learned.thrust_scale - VEHICLE.gravity
        velocity += PERIOD * (force - VEHICLE.drag * velocity)
        ekf.update(
            measured(v_WB_W=np.array([0.0, 0.0, velocity])),
            Input(throttle=throttle, w_WB_B=np.zeros(3)),
        )
        found.append(ekf.parameters())
    return found


@pytest.mark.parametrize("scale", [0.7, 1.3])
def test_lasting_error_in_hover_becomes_thrust_scale(scale: float) -> None:
    found = hovering(Ekf(parameters(), throttle=0.29), scale=scale, seconds=40.0)
    for learned in found[50:]:  # together they carry it all the while
        together = learned.thrust_scale / scale * VEHICLE.gravity + learned.a_W[2]
        assert together == pytest.approx(VEHICLE.gravity, abs=0.1)
    assert found[-1].thrust_scale == pytest.approx(scale, abs=0.005)
    assert found[-1].a_W[2] == pytest.approx(0.0, abs=0.05)


def test_reset_keeps_total_thrust() -> None:
    ekf = Ekf(parameters(rate=0.03, thrust=0.03), throttle=0.29)
    found = hovering(ekf, scale=0.8, seconds=0.6)[-1]
    assert abs(found.a_W[2]) > 0.05
    ekf.start_over()
    after = ekf.parameters()
    carried = found.thrust_scale * VEHICLE.gravity / (VEHICLE.gravity - found.a_W[2])
    assert after.thrust_scale == pytest.approx(carried, rel=1e-12)
    np.testing.assert_array_equal(after.a_W, 0.0)
    np.testing.assert_array_equal(after.rate_time_constants, 0.03)
    assert after.thrust_time_constant == 0.03


@pytest.mark.parametrize(
    "jump",
    [
        {"v_WB_W": np.array([1.0, 0.0, 0.0])},
        {"v_WB_W": np.array([0.0, 0.0, -0.6])},
    ],
)
def test_rejects_jump(jump: dict[str, Array]) -> None:
    ekf = Ekf(parameters(rate=0.03, thrust=0.03), throttle=0.29)
    hovering(ekf, scale=1.0, seconds=2.0)
    before, stepped = ekf.parameters(), measured(**jump)
    assert ekf.update(stepped) == UpdateMode.REJECT
    np.testing.assert_array_equal(numbers(ekf.parameters()), numbers(before))
    # From then on the new velocity is accepted.
    assert ekf.update(measured(**jump)) == UpdateMode.LEARN


@pytest.mark.parametrize(
    ("permitted", "saturated"), [(UpdateMode.VELOCITY_ONLY, False), (UpdateMode.LEARN, True)]
)
def test_long_pause_of_estimation_leads_to_hold_mode(
    permitted: UpdateMode, saturated: bool
) -> None:
    for paused_for, mode in ((0.4, UpdateMode.VELOCITY_ONLY), (0.6, UpdateMode.HOLD)):
        assert update_mode(permitted, saturated, paused_for) == mode


def test_saturated_commands_update_velocity_only() -> None:
    ekf = Ekf(parameters(), throttle=0.29)
    hovering(ekf, scale=1.0, seconds=1.0)
    ekf.reconfigure(throttle_min=0.0, throttle_max=HOVER, disturbance_max=5.0)
    before, velocity = ekf.parameters(), 0.0
    for _ in range(10):
        velocity += 0.02
        mode = ekf.update(measured(v_WB_W=np.array([0.0, 0.0, velocity])))
        assert mode == UpdateMode.VELOCITY_ONLY
        np.testing.assert_array_equal(numbers(ekf.parameters()), numbers(before))


@pytest.mark.parametrize("farthest", [2.0, 5.0, 15.0])
def test_estimates_are_bounded(farthest: float) -> None:
    """Velocities and rates are absurd."""
    ekf = Ekf(parameters(rate=0.03, thrust=0.03), throttle=0.29)
    ekf.reconfigure(throttle_min=0.0, throttle_max=1.0, disturbance_max=farthest)
    rng = np.random.default_rng(0)
    for k in range(500):
        before, after = (
            measured(
                rotation=so3.exp(rng.normal(size=3)),
                w_WB_B=20.0 * rng.normal(size=3),
                v_WB_W=np.full(3, 1.0 * k),
            )
            for _ in range(2)
        )
        ekf.update(after, command(0.1 * k), before=before)
        learned = ekf.parameters()
        assert np.abs(learned.a_W[:2]).max() <= farthest
        assert abs(learned.a_W[2]) <= 3.0
        assert 0.5 <= learned.thrust_scale <= 1.5
        assert 0.006 <= learned.rate_time_constants[0] <= 0.24
        assert 0.015 <= learned.thrust_time_constant <= 0.06
        assert 0.02 <= learned.drag <= 1.0


@pytest.mark.parametrize("farthest", [5.0, 15.0])
def test_strong_disturbance_is_estimated_up_to_its_bound(farthest: float) -> None:
    ekf = Ekf(parameters(), throttle=0.29)
    ekf.reconfigure(throttle_min=0.0, throttle_max=1.0, disturbance_max=farthest)
    push, speed, drag = 12.0, 0.0, Vehicle().drag
    for _ in range(75):
        speed += 0.02 * (push - drag * speed)
        ekf.update(measured(v_WB_W=np.array([speed, 0.0, 0.0])))
    learned = ekf.parameters()
    # Along a straight line a push hardly differs from air that slows less.
    explained = learned.a_W[0] - (learned.drag - drag) * speed
    assert (explained if push < farthest else learned.a_W[0]) == pytest.approx(
        min(push, farthest), rel=0.03
    )
    assert is_at_bounds(ekf.state) == (push > farthest)


def _lagging(time_constant: float) -> float:
    """Return the throttle at the end of the flight behind a lag."""
    decay, s = np.exp(-PERIOD / time_constant), 0.29
    for k in range(500):
        s = command(k * PERIOD).throttle + decay * (s - command(k * PERIOD).throttle)
    return float(s)

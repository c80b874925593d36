# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimates from body rates: lags of rate loops that are not of first order, and offsets."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.records import changed, state_of
from scipy.signal import cont2discrete

from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.ekf import VehicleEkf
from quad_mpc_ros.control.estimation.filter_state import Filter
from quad_mpc_ros.control.estimation.rate_update import update_rates
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.parameters import ModelParameters, parameters_of
from quad_mpc_ros.control.model.vehicle import ActuatorLags, Vehicle

PERIOD, FINE = 0.02, 0.0005  # s
USUAL_DELAY = 0.1  # s, with the default bandwidth
# A vehicle whose mass is off its centre, with a rate loop of this gain above lagging rotors.
THRUST, GAIN, ROTOR_LAG = 45.0, 60.0, 0.03  # m/s^2 at full throttle, 1/s, s
MASS, OFF_CENTRE, INERTIA = 0.75, 0.014, 2.1e-3  # kg, m, kg m^2
QUICK_LAG = 0.033


class Rates:
    """The rate filter alone."""

    def __init__(self, nominal: ModelParameters, *, delay: float = 0.0) -> None:
        self._state = Filter.zeros()[()]
        self.ekf = VehicleEkf(nominal, throttle=0.3, delay=delay, state=self._state)

    def follow(
        self, commands: Array, rates: Array, *, period: float = PERIOD, learns: bool = True
    ) -> list[ModelParameters]:
        """Update with commands (n, 4) and the rates (n, 3) before them; return the estimates."""
        found = []
        for k in range(1, len(commands)):
            mode = UpdateMode.LEARN if learns else UpdateMode.VELOCITY_ONLY
            update_rates(
                self._state,
                state_of(actuators=[0.0, *rates[k]]),
                Acting(durations=np.array([period]), commands=commands[k - 1 : k]),
                UpdateMode.HOLD if k == 1 else mode,
            )
            found.append(self.ekf.parameters())
        return found


def lagging(lag: float) -> ModelParameters:
    return parameters_of(Vehicle(), ActuatorLags(rate=lag, thrust=0.0))[()]


def rates_of_a_loop(commands: Array, *, gain: float, rotor_lag: float) -> Array:
    """Return the rates (n,) of a proportional rate loop through lagging rotors, by scipy.

    gain / (rotor_lag s^2 + s + gain): for slow commands it is behind by 1 / gain.
    """
    system = (
        np.array([[0.0, 1.0], [-gain / rotor_lag, -1.0 / rotor_lag]]),
        np.array([[0.0], [gain / rotor_lag]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )
    A, B, *_ = cont2discrete(system, PERIOD)
    x, rates = np.zeros(2), []
    for command in commands:
        rates.append(x[0])
        x = A @ x + B[:, 0] * command
    return np.array(rates)


def same_rates(commands: Array) -> Array:
    """Return commands (n, 4) with the same rates (n,) about all axes."""
    return np.column_stack((np.full(len(commands), 0.3), commands, commands, commands))


@pytest.mark.parametrize("chatter", [0.0, 0.2])
@pytest.mark.parametrize("gain", [15.0, 20.0, 30.0])
def test_second_order_rate_loop_has_its_low_frequency_lag(gain: float, chatter: float) -> None:
    seconds = PERIOD * np.arange(1500)
    slow = 0.8 * np.sin(2.0 * seconds) + 0.6 * np.sin(3.1 * seconds)
    commands = slow + chatter * np.random.default_rng(0).normal(size=len(slow))
    roll_pitch = rates_of_a_loop(commands, gain=gain, rotor_lag=0.03)
    yaw = rates_of_a_loop(commands, gain=0.25 * gain, rotor_lag=0.03)
    rates = np.column_stack((roll_pitch, roll_pitch, yaw))
    learned = Rates(lagging(0.045), delay=USUAL_DELAY).follow(same_rates(commands), rates)[-1]
    roll, pitch, slow_yaw = learned.rate_time_constants
    assert roll == pitch == pytest.approx(1.0 / gain, rel=0.15)
    assert slow_yaw == pytest.approx(4.0 / gain, rel=0.15)


def test_the_lag_of_a_quick_vehicle_is_estimated_up_to_its_bound() -> None:
    """Late odometry looks like a lag."""
    seconds = PERIOD * np.arange(1500)
    commands = 0.8 * np.sin(2.0 * seconds) + 0.6 * np.sin(3.1 * seconds)
    rates = np.column_stack([rates_of_a_loop(commands, gain=8.0, rotor_lag=0.001)] * 3)
    learned = Rates(lagging(0.033)).follow(same_rates(commands), rates)[-1]
    roll, pitch, yaw = learned.rate_time_constants
    assert roll == pitch == pytest.approx(2.75 * 0.033, rel=1e-3)
    assert yaw == pytest.approx(0.125, rel=0.15)


@pytest.mark.parametrize(("gain", "rotor_lag"), [(25.0, 0.03), (25.0, 0.15), (4.0, 0.12)])
def test_identifies_rate_loops_that_ring_or_are_slow(gain: float, rotor_lag: float) -> None:
    seconds = PERIOD * np.arange(500)
    commands = 0.8 * np.sin(2.0 * seconds) + 0.6 * np.sign(np.sin(3.1 * seconds))
    rates = np.column_stack([rates_of_a_loop(commands, gain=gain, rotor_lag=rotor_lag)] * 3)
    nominal = parameters_of(Vehicle(), ActuatorLags(rate=0.07, torque=0.02, thrust=0.04))[()]
    learned = Rates(nominal, delay=USUAL_DELAY).follow(same_rates(commands), rates)[-1]
    np.testing.assert_allclose(learned.rate_time_constants, 1.0 / gain, rtol=0.05)
    np.testing.assert_allclose(learned.torque_time_constants, rotor_lag, rtol=0.1)


@pytest.mark.parametrize("outlier", [3.0, 6.0, -100.0])
def test_single_wrong_rates_do_not_change_the_lag(outlier: float) -> None:
    """As in a hover with one sample in ten of another unit."""
    commands = 0.1 * np.random.default_rng(0).normal(size=500)
    true = rates_of_a_loop(commands, gain=1.0 / 0.07, rotor_lag=0.02)
    wrong = true.copy()
    wrong[100::10] += outlier
    nominal = parameters_of(Vehicle(), ActuatorLags(rate=0.07, torque=0.02, thrust=0.04))[()]
    for rates in (true, wrong):
        same = np.column_stack([rates] * 3)
        learned = Rates(nominal, delay=USUAL_DELAY).follow(same_rates(commands), same)[-1]
        np.testing.assert_allclose(learned.rate_time_constants, 0.07, rtol=0.1)
        np.testing.assert_allclose(learned.torque_time_constants, 0.02, rtol=0.1)


@pytest.mark.parametrize("gain", [60.0, 100.0])
def test_a_lag_far_below_the_configured_is_estimated(gain: float) -> None:
    """A racer's lag is far below the default of 70 ms."""
    commands = 2.0 * np.sin(6.0 * PERIOD * np.arange(1500))
    rates = np.column_stack([rates_of_a_loop(commands, gain=gain, rotor_lag=0.0001)] * 3)
    learned = Rates(lagging(0.07), delay=USUAL_DELAY).follow(same_rates(commands), rates)[-1]
    roll, pitch, _ = learned.rate_time_constants
    assert roll == pitch == pytest.approx(1.0 / gain, rel=0.15)


def off_centre_rates(
    throttle: Array, commands: Array, *, integral: float, off: float
) -> tuple[Array, Array]:
    """Return the rates (n,) of a rate loop above lagging rotors that carry a mass off centre.

    And the offset of the rates (n,): torques other than those of the error, over the gain.
    """
    w = found = thrust = torque = 0.0  # torques over the inertia
    steps, rates, beyond = round(0.5 * PERIOD / FINE), [], []
    for s, command in zip(throttle, commands, strict=True):
        rates.append(w)
        beyond.append((MASS * THRUST * s * off / INERTIA + found) / GAIN)
        for _ in range(steps):
            found += FINE * integral * (command - w)
            thrust += FINE / ROTOR_LAG * (THRUST * s - thrust)
            torque += FINE / ROTOR_LAG * (GAIN * (command - w) + found - torque)
            w += FINE * (torque + MASS * thrust * off / INERTIA)
    return np.array(rates), np.array(beyond)


def quick(lag: float = QUICK_LAG) -> ModelParameters:
    return changed(ModelParameters.zeros()[()], b=THRUST, gravity=9.81, rate_time_constants=lag)


def pitch_offsets(
    throttle: Array, commands: Array, rates: Array, *, rates_of: Rates, learns: bool = True
) -> Array:
    """Return the offset of the pitch rate, fixed and by thrust (n, 2); other rates have none."""
    none = np.zeros(len(rates))
    acting = np.column_stack((throttle, none, commands, none))
    found = rates_of.follow(
        acting, np.column_stack((none, rates, none)), period=0.5 * PERIOD, learns=learns
    )
    assert not any(np.any(each.rate_offset[[0, 2]]) for each in found)
    return np.array([(each.rate_offset[1], each.rate_offset_by_thrust[1]) for each in found])


def manoeuvre(seconds: float) -> tuple[Array, Array]:
    """Return throttle and commanded rates of a flight that pulls up now and then."""
    t = np.arange(0.0, seconds, 0.5 * PERIOD)
    throttle = 9.81 / THRUST + 0.18 * (1.0 + np.sin(2.3 * t)) / 2.0
    return throttle, 1.2 * np.sin(3.1 * t) + 0.7 * np.cos(5.3 * t)


def test_offset_centre_of_mass_matches_physics() -> None:
    throttle, commands = manoeuvre(10.0)
    rates, beyond = off_centre_rates(throttle, commands, integral=0.0, off=OFF_CENTRE)
    found = pitch_offsets(throttle, commands, rates, rates_of=Rates(quick()))
    assert found[-1, 1] == pytest.approx(MASS * OFF_CENTRE / INERTIA / GAIN, rel=0.1)
    off = found[:, 0] + found[:, 1] * THRUST * throttle[:-1] - beyond[:-1]
    assert np.abs(off[100:]).max() < 0.1  # of 0.8 to 1.5 rad/s


def test_estimates_the_offset_despite_an_integral_term() -> None:
    throttle, commands = manoeuvre(10.0)
    rates, beyond = off_centre_rates(throttle, commands, integral=60.0, off=OFF_CENTRE)
    found = pitch_offsets(throttle, commands, rates, rates_of=Rates(quick()))
    off = found[:, 0] + found[:, 1] * THRUST * throttle[:-1] - beyond[:-1]
    assert np.std(off[200:]) < 0.5 * np.std(beyond[200:])


def test_delay_is_not_learned_as_offset() -> None:
    """A loop with 80 ms of hidden delay oscillates like this; throttle and rates go together."""
    t = np.arange(0.0, 10.0, 0.5 * PERIOD)
    commands = 1.5 * np.sin(6.0 * t)
    throttle = 9.81 / THRUST * (1.0 + 0.1 * np.sin(6.0 * t + 0.4))
    late = np.concatenate((np.zeros(8), commands[:-8]))
    rates, _ = off_centre_rates(throttle, late, integral=0.0, off=0.0)
    found = pitch_offsets(throttle, commands, rates, rates_of=Rates(quick()))
    total = found[:, 0] + found[:, 1] * THRUST * throttle[:-1]
    hidden = np.abs(commands - late).max()
    assert np.abs(total[50:]).max() < 0.25 * hidden


@pytest.mark.parametrize(
    ("lag", "delay", "learns"), [(QUICK_LAG, 0.0, False), (0.0, 0.0, True), (0.033, 0.1, True)]
)
def test_no_offset_without_learning_or_short_lags(lag: float, delay: float, learns: bool) -> None:
    throttle, commands = manoeuvre(3.0)
    rates, _ = off_centre_rates(throttle, commands, integral=0.0, off=OFF_CENTRE)
    none = Rates(quick(lag), delay=delay)
    assert not pitch_offsets(throttle, commands, rates, rates_of=none, learns=learns).any()


def test_offsets_are_bounded() -> None:
    steady = np.full(500, 9.81 / THRUST)
    found = pitch_offsets(steady, np.zeros(500), np.full(500, 50.0), rates_of=Rates(quick()))
    fixed, by_thrust = np.abs(found[-1])
    assert fixed <= 3.0
    assert by_thrust <= 0.2

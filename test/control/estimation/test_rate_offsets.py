"""What roll and pitch rate have beyond their commands: of a centre of mass, and not of delays."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.records import changed

from quad_mpc_ros.control.estimation import rate_offsets
from quad_mpc_ros.control.estimation.rate_offsets import RateOffsets
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.parameters import ModelParameters

PERIOD, FINE = 0.01, 0.0005  # s
THRUST = 45.0  # m/s^2 at full throttle
GAIN, ROTOR_LAG = 60.0, 0.03  # 1/s, s
MASS, OFF_CENTRE, INERTIA = 0.75, 0.014, 2.1e-3  # kg, m, kg m^2


def nominal(lag: float = 0.033) -> ModelParameters:
    return changed(ModelParameters.zeros()[()], b=THRUST, rate_time_constants=lag)


def started(*, lag: float = 0.033, share: float = 1.0) -> RateOffsets:
    offsets = RateOffsets.zeros()[()]
    rate_offsets.start(offsets, nominal(lag), share=share)
    return offsets


def pitch_offset(offsets: RateOffsets) -> tuple[float, float]:
    """Return the offset of the pitch rate, fixed and by thrust; other rates have none."""
    parameters = nominal()
    rate_offsets.write(offsets, parameters)
    fixed, by_thrust = parameters.rate_offset, parameters.rate_offset_by_thrust
    assert not any((fixed[0], fixed[2], by_thrust[0], by_thrust[2]))
    return float(fixed[1]), float(by_thrust[1])


def rates_of_a_loop(
    throttle: Array, commands: Array, *, integral: float, off: float
) -> tuple[Array, Array]:
    """Return the rates (n,) of a rate loop above lagging rotors that carry a mass off centre.

    And what the rate is off for, the torques beside those for the error, over the gain.
    """
    w = found = thrust = torque = 0.0  # torques over the inertia
    steps, rates, beyond = round(PERIOD / FINE), [], []
    for s, command in zip(throttle, commands, strict=True):
        rates.append(w)
        beyond.append((MASS * THRUST * s * off / INERTIA + found) / GAIN)
        for _ in range(steps):
            found += FINE * integral * (command - w)
            thrust += FINE / ROTOR_LAG * (THRUST * s - thrust)
            torque += FINE / ROTOR_LAG * (GAIN * (command - w) + found - torque)
            w += FINE * (torque + MASS * thrust * off / INERTIA)
    return np.array(rates), np.array(beyond)


def followed(
    offsets: RateOffsets, throttle: Array, commands: Array, rates: Array, *, learns: bool = True
) -> list[tuple[float, float]]:
    """Tell of rates of pitch; return its offset, fixed and by thrust, over time."""
    estimated = []
    for k in range(1, len(rates)):
        rate_offsets.follow(
            offsets=offsets,
            nominal=nominal(),
            lags=(0.033, 0.033, 0.033),
            commands=np.array([[throttle[k - 1], 0.0, commands[k - 1], 0.0]]),
            durations=np.array([PERIOD]),
            measured=np.array([0.0, rates[k], 0.0]),
            learns=learns,
            follows=k > 1,
        )
        estimated.append(pitch_offset(offsets))
    return estimated


def manoeuvre(seconds: float) -> tuple[Array, Array]:
    """Return throttle and commanded rates of a flight that pulls up now and then."""
    t = np.arange(0.0, seconds, PERIOD)
    throttle = 9.81 / THRUST + 0.18 * (1.0 + np.sin(2.3 * t)) / 2.0
    return throttle, 1.2 * np.sin(3.1 * t) + 0.7 * np.cos(5.3 * t)


def test_offset_centre_of_mass_matches_physics() -> None:
    throttle, commands = manoeuvre(10.0)
    rates, beyond = rates_of_a_loop(throttle, commands, integral=0.0, off=OFF_CENTRE)
    estimated = np.array(followed(started(), throttle, commands, rates))
    assert estimated[-1, 1] == pytest.approx(MASS * OFF_CENTRE / INERTIA / GAIN, rel=0.1)
    off = estimated[:, 0] + estimated[:, 1] * THRUST * throttle[:-1] - beyond[:-1]
    assert np.abs(off[100:]).max() < 0.1  # of 0.8 to 1.5 rad/s


def test_learns_what_integral_compensates() -> None:
    throttle, commands = manoeuvre(10.0)
    rates, beyond = rates_of_a_loop(throttle, commands, integral=60.0, off=OFF_CENTRE)
    estimated = np.array(followed(started(), throttle, commands, rates))
    off = estimated[:, 0] + estimated[:, 1] * THRUST * throttle[:-1] - beyond[:-1]
    assert np.std(off[200:]) < 0.5 * np.std(beyond[200:])


def test_delay_is_not_learned_as_offset() -> None:
    """A loop with 80 ms of hidden delay oscillates like this; throttle and rates go together."""
    t = np.arange(0.0, 10.0, PERIOD)
    commands = 1.5 * np.sin(6.0 * t)
    throttle = 9.81 / THRUST * (1.0 + 0.1 * np.sin(6.0 * t + 0.4))
    late = np.concatenate((np.zeros(8), commands[:-8]))
    rates, _ = rates_of_a_loop(throttle, late, integral=0.0, off=0.0)
    estimated = np.array(followed(started(), throttle, commands, rates))
    total = estimated[:, 0] + estimated[:, 1] * THRUST * throttle[:-1]
    hidden = np.abs(commands - late).max()
    assert np.abs(total[50:]).max() < 0.25 * hidden


def test_no_offset_without_learning_or_lags() -> None:
    throttle, commands = manoeuvre(3.0)
    rates, _ = rates_of_a_loop(throttle, commands, integral=0.0, off=OFF_CENTRE)
    for lag, share, learns in ((0.033, 1.0, False), (0.0, 1.0, True), (0.033, 0.0, True)):
        offsets = started(lag=lag, share=share)
        assert not np.any(followed(offsets, throttle, commands, rates, learns=learns))


def test_reset_clears_offsets_and_recall_restores_them() -> None:
    throttle, commands = manoeuvre(3.0)
    rates, _ = rates_of_a_loop(throttle, commands, integral=0.0, off=OFF_CENTRE)
    offsets = started()
    estimated = followed(offsets, throttle, commands, rates)[-1]
    kept = offsets.estimate.copy()
    rate_offsets.reset(offsets)
    assert pitch_offset(offsets) == (0.0, 0.0)
    offsets.estimate = kept
    assert pitch_offset(offsets) == estimated


def test_offsets_are_bounded() -> None:
    steady = np.full(500, 9.81 / THRUST)
    offsets = started()
    fixed, slope = followed(offsets, steady, np.zeros(500), np.full(500, 50.0))[-1]
    assert abs(fixed) <= 3.0
    assert abs(slope) <= 0.2

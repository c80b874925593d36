"""The time constants of rate loops that are not of first order."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete

from quad_mpc_ros.control.estimation import rate_lags
from quad_mpc_ros.control.estimation.rate_lags import RateLags
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.parameters import ModelParameters, parameters_of
from quad_mpc_ros.control.model.vehicle import Vehicle

PERIOD = 0.02


def nominal(lag: float) -> ModelParameters:
    return parameters_of(Vehicle(), rate_time_constant=lag, thrust_time_constant=0.0)[()]


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


def learned(commands: Array, rates: Array, *, lag: float, slower: float = 1.0) -> Array:
    """Return the time constants (3,) estimated from commands (n,) and rates (n, 3)."""
    lags = RateLags.zeros()[()]
    rate_lags.start(lags, nominal(lag), slower=slower)
    for k in range(1, len(commands)):
        rate_lags.follow(
            lags=lags,
            commands=np.array([[0.3, *[commands[k - 1]] * 3]]),
            durations=np.array([PERIOD]),
            measured=rates[k],
            learns=True,
            follows=k > 1,
        )
    return np.array(rate_lags.time_constants(lags))


@pytest.mark.parametrize("chatter", [0.0, 0.2])
@pytest.mark.parametrize("gain", [15.0, 20.0, 30.0])
def test_second_order_rate_loop_has_its_low_frequency_lag(gain: float, chatter: float) -> None:
    seconds = PERIOD * np.arange(1500)
    slow = 0.8 * np.sin(2.0 * seconds) + 0.6 * np.sin(3.1 * seconds)
    commands = slow + chatter * np.random.default_rng(0).normal(size=len(slow))
    roll_pitch = rates_of_a_loop(commands, gain=gain, rotor_lag=0.03)
    yaw = rates_of_a_loop(commands, gain=0.25 * gain, rotor_lag=0.03)
    rates = np.column_stack((roll_pitch, roll_pitch, yaw))
    roll, pitch, slow_yaw = learned(commands, rates, lag=0.045)
    assert roll == pitch == pytest.approx(1.0 / gain, rel=0.15)
    assert slow_yaw == pytest.approx(4.0 / gain, rel=0.15)


@pytest.mark.parametrize(("slower", "longest"), [(1.0, 0.066), (0.25, 0.04125)])
def test_lag_is_estimated_up_to_its_bound(slower: float, longest: float) -> None:
    seconds = PERIOD * np.arange(1500)
    commands = 0.8 * np.sin(2.0 * seconds) + 0.6 * np.sin(3.1 * seconds)
    rates = rates_of_a_loop(commands, gain=10.0, rotor_lag=0.001)
    rates = np.column_stack([rates] * 3)
    roll, pitch, yaw = learned(commands, rates, lag=0.033, slower=slower)
    assert roll == pitch == pytest.approx(longest)
    assert yaw == pytest.approx(0.1, rel=0.15)

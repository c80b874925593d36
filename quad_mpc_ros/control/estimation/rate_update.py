"""Prediction and update of the body rates and their parameters."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import error_state, kalman
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.error_state import RATES, ROLL_PITCH, YAW
from quad_mpc_ros.control.estimation.filter_state import Filter, LowpassedRates
from quad_mpc_ros.control.estimation.process_model import predict_rates
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag
from quad_mpc_ros.control.model.parameters import modelled_thrust
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.state import U_RATE, U_THROTTLE

_LOWPASS_TIME = 0.1  # s, low-pass of commands and rates
_RATE_NOISE = 0.02  # rad/s / sqrt(Hz), measurement noise of a rate


@compiled
def update_rates(state: Filter, after: StateRecord, acting: Acting, mode: UpdateMode) -> None:
    """Predict and update the rates and their parameters."""
    x, P, noise, n = state.rates.x, state.rates.P, state.process_noise.rates, RATES.size
    if P[ROLL_PITCH, ROLL_PITCH] + P[YAW, YAW] <= 0.0:
        return
    duration, lowpass = acting.durations.sum(), _lowpassed(state.lowpass, acting, after.w_WB_B)
    if mode in (UpdateMode.HOLD, UpdateMode.REJECT):
        take_rates(state)
        return
    F, H = np.empty((n, n)), np.empty((3, n))
    predict_rates(state.nominal, state.rate_lags.share, state.rates, lowpass, F, H)
    Q = np.zeros(n)
    for i in range(n):
        if i < RATES.lag or P[i, i] < noise.P[i, i]:
            Q[i] = noise.x[i] * duration
    kalman.predict(P, F, Q)
    nu, considered = np.zeros(3), np.zeros(n)
    for k in range(3):
        for i in range(n):
            nu[k] -= H[k, i] * x[i]
        nu[k] += state.lowpass.measured[k]
    if mode != UpdateMode.LEARN:
        considered[RATES.lag :] = 1.0
    R = _RATE_NOISE**2 / duration
    kalman.update(x, P, kalman.innovation(P, H, R, nu), considered)
    _constrain_rates(state, considered)


@compiled
def take_rates(state: Filter) -> None:
    """Set the rates to the low-passed measurement, and keep the parameters."""
    x, P = state.rates.x, state.rates.P
    for k in range(3):
        i = RATES.rate + k
        x[i] = state.lowpass.measured[k]
        P[i, :] = 0.0
        P[:, i] = 0.0


@compiled
def begin_rates(state: Filter, w_WB_B: Array) -> None:
    """Start at measured rates (3,).

    The low-pass starts with commands that equal the rates less the offset, so that low-passed
    rates follow low-passed commands through the same lag.
    """
    lowpass = state.lowpass
    lowpass.command[:] = 0.0
    add_offsets(state, lowpass.command)
    for k in range(3):
        lowpass.measured[k] = lowpass.last[k] = w_WB_B[k]
        lowpass.command[U_RATE + k] = w_WB_B[k] - lowpass.command[U_RATE + k]
    take_rates(state)


@compiled
def _lowpassed(lowpass: LowpassedRates, acting: Acting, measured: Array) -> Acting:
    """Low-pass commands and measured rates (3,); return the commands, means over the durations.

    Rates are interpolated linearly between measurements.
    """
    commands = acting.commands.copy()
    for k in range(len(commands)):
        decay, share = first_order_lag(_LOWPASS_TIME, acting.durations[k])
        for i in range(commands.shape[1]):
            command, off = acting.commands[k, i], lowpass.command[i] - acting.commands[k, i]
            commands[k, i] = command + share * off
            lowpass.command[i] = command + decay * off
    decay, share = first_order_lag(_LOWPASS_TIME, acting.durations.sum())
    for i in range(3):
        change = measured[i] - lowpass.last[i]
        lowpass.measured[i] = (
            decay * (lowpass.measured[i] - lowpass.last[i]) + measured[i] - share * change
        )
        lowpass.last[i] = measured[i]
    return Acting(acting.durations, commands)


@compiled
def add_offsets(state: Filter, command: Array) -> None:
    """Add the estimated rate offsets to a command (4,)."""
    x, thrust = state.rates.x, modelled_thrust(state.nominal, command[U_THROTTLE])
    for k in range(2):
        command[U_RATE + k] += x[RATES.offset + k] + x[RATES.offset_by_thrust + k] * thrust


@compiled
def _constrain_rates(state: Filter, considered: Array) -> None:
    """Project the parameters of the rates into their bounds."""
    x, P, lags = state.rates.x, state.rates.P, state.rate_lags
    for i, axis in ((ROLL_PITCH, 0), (YAW, 2)):
        bounds = lags.shortest[axis], lags.longest[axis]
        kalman.constrain(x, P, i, bounds, considered)
    for k in range(2):
        i, most = RATES.offset + k, error_state.OFFSET_BOUND
        x[i] = kernels.clamp(x[i], -most, most)
        i, most = RATES.offset_by_thrust + k, error_state.OFFSET_BY_THRUST_BOUND
        x[i] = kernels.clamp(x[i], -most, most)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Prediction and update of the body rates and their parameters.

The modelled rates follow their commands and offsets through the loop of each axis. The Jacobian is
the forward differences of this prediction.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import kalman
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.filter_state import (
    DIFFERENCE,
    LONGEST_RATE_LAG,
    OFFSET_BOUND,
    OFFSET_BY_THRUST_BOUND,
    RATES,
    ROLL_PITCH,
    SHORTEST_RATE_LAG,
    TORQUE_LAG_FACTOR,
    YAW,
    Filter,
    LowpassedRates,
    loop_lags,
)
from quad_mpc_ros.control.estimation.loop_rates import follow_loops, start_loops
from quad_mpc_ros.control.estimation.rate_weights import update_rate_weights
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import axis_step, first_order_lag, loop_step
from quad_mpc_ros.control.model.parameters import modelled_thrust
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.state import U_RATE, U_THROTTLE

_LOWPASS_TIME = 0.1  # s, low-pass of commands and rates
# Of the angular acceleration: shortest time of a correction, and the lag that halves it.
_CORRECTION_TIME, _CORRECTED_LAG = 0.05, 0.1  # s
_RATE_NOISE = 0.02  # rad/s / sqrt(Hz), measurement noise of a rate
_OUTLIER = 2.0  # rad/s, change of the rates that neither commands nor their last change explain


@compiled
def update_rates(state: Filter, after: StateRecord, acting: Acting, mode: UpdateMode) -> None:
    """Predict and update the rates and their parameters."""
    x, P, noise, n = state.rates.x, state.rates.P, state.process_noise.rates, RATES.size
    if P[RATES.lag, RATES.lag] + P[RATES.lag + YAW, RATES.lag + YAW] <= 0.0:
        return
    duration, w_WB_B = acting.durations.sum(), after.w_WB_B.copy()
    state.lowpass.skipped = int(_is_outlier(state.lowpass, acting, w_WB_B))
    if state.lowpass.skipped:
        w_WB_B[:] = state.lowpass.last
    _follow_estimated_loop(state, acting, kernels.vector(w_WB_B))
    off = _interpolation_error(state.lowpass, w_WB_B)
    lowpass = _lowpassed(state.lowpass, acting, w_WB_B)
    if mode in (UpdateMode.HOLD, UpdateMode.REJECT):
        take_rates(state)
        return
    F, H, Q = predict_rates(state, lowpass), np.zeros((3, n)), np.zeros(n)
    for i in range(n):
        if i < RATES.lag or P[i, i] < noise.P[i, i]:
            Q[i] = noise.x[i] * duration
    kalman.predict(P, F, Q)
    nu, considered = np.zeros(3), np.zeros(n)
    for k in range(3):
        H[k, RATES.rate + k] = 1.0
        nu[k] = state.lowpass.measured[k] - x[RATES.rate + k]
    if mode != UpdateMode.LEARN:
        considered[RATES.lag :] = 1.0
    share = -math.expm1(-duration / _LOWPASS_TIME)  # of the low-pass
    R = _RATE_NOISE**2 / duration + (share * off) ** 2
    kalman.update(x, P, kalman.innovation(P, H, R, nu), considered)
    _constrain_rates(state, considered)
    update_rate_weights(state, duration)


@compiled
def _follow_estimated_loop(state: Filter, acting: Acting, w: kernels.Vector) -> None:
    """Compare measured rates with those of the estimated loop after the mean of the commands."""
    duration, mean, loops = acting.durations.sum(), np.zeros(3), np.empty((1, 3, 2))
    for axis in range(3):
        loops[0, axis, 0], loops[0, axis, 1] = loop_lags(state, axis)
        for n in range(len(acting.durations)):
            mean[axis] += acting.durations[n] / duration * acting.commands[n, U_RATE + axis]
    unbounded = math.inf, math.inf, math.inf
    follow_loops(state.loop, loops, mean, w, acceleration_max=unbounded, duration=duration)


@compiled
def predict_rates(state: Filter, acting: Acting) -> Array:
    """Predict rates and accelerations of the model, and return the Jacobian (n, n)."""
    x, F = state.rates.x, np.eye(RATES.size)
    for axis in range(3):
        k, i, j = YAW if axis == 2 else ROLL_PITCH, RATES.rate + axis, RATES.acceleration + axis
        w, acceleration = _followed(state, acting, axis, (x[i], x[j]), math.inf)
        columns = (
            i,
            j,
            RATES.lag + k,
            RATES.torque_lag + k,
            RATES.offset + axis,
            RATES.offset_by_thrust + axis,
        )
        for n in range(6 if axis < 2 else 4):  # yaw has no offsets
            column, kept = columns[n], x[columns[n]]
            x[column] += DIFFERENCE
            moved = _followed(state, acting, axis, (x[i], x[j]), math.inf)
            x[column] = kept
            F[i, column] = (moved[0] - w) / DIFFERENCE
            F[j, column] = (moved[1] - acceleration) / DIFFERENCE
        x[i], x[j] = w, acceleration
    return F


@compiled
def _followed(
    state: Filter, acting: Acting, axis: int, start: tuple[float, float], most: float
) -> tuple[float, float]:
    """Return rate and acceleration of an axis after commands, from both at their ``start``.

    ``most`` bounds the demanded acceleration [rad/s^2].
    """
    (tau, lag), (w, acceleration) = loop_lags(state, axis), start
    for n in range(len(acting.durations)):
        loop = loop_step(tau, lag, most, acting.durations[n])
        command = acting.commands[n, U_RATE + axis]
        if axis < 2:
            command += _offset(state, axis, acting.commands[n, U_THROTTLE])
        step = axis_step(loop, w, acceleration, command)
        w, acceleration = step.rate, step.acceleration
    return w, acceleration


@compiled
def _offset(state: Filter, axis: int, throttle: float) -> float:
    """Return the estimated offset of roll or pitch rate from its command at a throttle."""
    x, thrust = state.rates.x, modelled_thrust(state.nominal, throttle)
    return float(x[RATES.offset + axis] + x[RATES.offset_by_thrust + axis] * thrust)


@compiled
def take_rates(state: Filter) -> None:
    """Set the rates to the low-passed measurement, and keep the parameters."""
    x, P = state.rates.x, state.rates.P
    for i in range(RATES.lag):
        x[i] = state.lowpass.measured[i] if i < RATES.acceleration else 0.0
        P[i, :] = 0.0
        P[:, i] = 0.0


@compiled
def begin_rates(state: Filter, w_WB_B: Array) -> None:
    """Start at measured rates (3,).

    The low-pass starts with commands that equal the rates minus the offset, so that low-passed
    rates follow low-passed commands through the same lag.
    """
    lowpass = state.lowpass
    lowpass.command[:] = 0.0
    add_offsets(state, lowpass.command)
    for k in range(3):
        lowpass.measured[k] = lowpass.last[k] = w_WB_B[k]
        lowpass.change[k] = 0.0
        lowpass.command[U_RATE + k] = w_WB_B[k] - lowpass.command[U_RATE + k]
    start_loops(state.loop, kernels.vector(w_WB_B))
    take_rates(state)


@compiled
def track_acceleration(
    state: Filter, before: StateRecord, after: StateRecord, acting: Acting
) -> None:
    """Write the angular acceleration of a measured state ``after``.

    The measured rates correct the acceleration of the model. A shorter torque lag needs less
    correction: the model's own error decays with the lag.
    """
    duration = acting.durations.sum()
    for axis in range(3):
        _tau, lag = loop_lags(state, axis)
        if lag <= 0.0:
            after.angular_acceleration[axis] = 0.0
            continue
        start = before.w_WB_B[axis], before.angular_acceleration[axis]
        most = state.nominal.angular_acceleration_max[axis]
        w, acceleration = _followed(state, acting, axis, start, most)
        missed = (after.w_WB_B[axis] - w) / max(duration, _CORRECTION_TIME)
        share = lag / (lag + _CORRECTED_LAG)
        after.angular_acceleration[axis] = acceleration + share * missed


@compiled
def _is_outlier(lowpass: LowpassedRates, acting: Acting, measured: Array) -> bool:
    """Whether measured rates (3,) jump without a cause; of two in a row the second is not.

    A rate loop moves the rates towards its command, and goes on as it did before.
    """
    largest = 0.0
    for k in range(3):
        i, last = U_RATE + k, lowpass.last[k]
        cause = max(abs(lowpass.command[i] - last), np.abs(acting.commands[:, i] - last).max())
        largest = max(largest, abs(measured[k] - last) - 2.0 * (cause + abs(lowpass.change[k])))
    return largest > _OUTLIER and not lowpass.skipped


@compiled
def _interpolation_error(lowpass: LowpassedRates, measured: Array) -> float:
    """Return the deviation of rates from a straight line to the measured rates (3,) [rad/s].

    A parabola is off by an eighth of its second difference at most. Half of this is used, so that
    commands that alternate at each sample still reveal short lags.
    """
    largest = 0.0
    for k in range(3):
        change = measured[k] - lowpass.last[k]
        largest = max(largest, abs(change - lowpass.change[k]))
        lowpass.change[k] = change
    return largest / 16.0


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
    for k in range(2):
        command[U_RATE + k] += _offset(state, k, command[U_THROTTLE])


@compiled
def _constrain_rates(state: Filter, considered: Array) -> None:
    """Project the parameters of the rates into their bounds."""
    x, P = state.rates.x, state.rates.P
    shortest, torque = (
        math.log(SHORTEST_RATE_LAG),
        math.log(TORQUE_LAG_FACTOR),
    )
    for k, longest in ((ROLL_PITCH, state.longest_rate_lag), (YAW, LONGEST_RATE_LAG)):
        kalman.constrain(x, P, RATES.lag + k, (shortest, math.log(longest)), considered)
        kalman.constrain(x, P, RATES.torque_lag + k, (-torque, torque), considered)
    for k in range(2):
        i, most = RATES.offset + k, OFFSET_BOUND
        x[i] = kernels.clamp(x[i], -most, most)
        i, most = RATES.offset_by_thrust + k, OFFSET_BY_THRUST_BOUND
        x[i] = kernels.clamp(x[i], -most, most)

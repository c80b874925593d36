"""Initial variances and process noise of each state, from the configured parameters."""

from __future__ import annotations

import math

from quad_mpc_ros.control.estimation import error_state, measurement_noise
from quad_mpc_ros.control.estimation.error_state import (
    MOTION,
    RATES,
    ROLL_PITCH,
    YAW,
    variances_at,
)
from quad_mpc_ros.control.estimation.filter_state import Filter
from quad_mpc_ros.control.model.parameters import ModelParameters

# Of the model's rates [rad/s / sqrt(s)] and angular accelerations [rad/s^2 / sqrt(s)].
_RATE_PROCESS_NOISE, _ACCELERATION_PROCESS_NOISE = 0.2, 2.0
# Latency of the default vehicle from command to response [s], and the largest bandwidth scale.
_DEFAULT_LATENCY, _MAX_BANDWIDTH_SCALE = 0.13, 4.0


def set_initial_variances(state: Filter, bandwidth_scale: float) -> None:
    """Write the initial variances and the process noise of each state."""
    nominal = state.nominal
    translation, rates = state.process_noise.translation, state.process_noise.rates
    roll, pitch, yaw = nominal.rate_time_constants.tolist()
    torque_roll, _pitch, torque_yaw = nominal.torque_time_constants.tolist()
    # Quickly estimated offsets raise the bandwidth: only for vehicles configured with short lags.
    share = min(bandwidth_scale - 1.0, 1.0) if max(roll, pitch, yaw) > 0.0 else 0.0
    d = MOTION.disturbance
    for i, assumed, scale in (
        (d, error_state.DISTURBANCE, 1.0),
        (d + 1, error_state.DISTURBANCE, 1.0),
        (d + 2, error_state.VERTICAL, 1.0),
        (MOTION.scale, error_state.SCALE, 1.0),
        (MOTION.lag, error_state.THRUST_LAG, nominal.thrust_time_constant),
        (MOTION.drag, error_state.DRAG, 1.0),
    ):
        translation.P[i, i], translation.x[i] = variances_at(assumed, scale)
    initial = measurement_noise.drift_variance_in(state.drift, 0.0)
    for k in range(3):
        translation.P[MOTION.bias + k, MOTION.bias + k] = initial
    for i, assumed, scale in (
        (RATES.lag + ROLL_PITCH, error_state.RATE_LAG, float(roll + pitch > 0.0)),
        (RATES.lag + YAW, error_state.RATE_LAG, float(yaw > 0.0)),
        (RATES.torque_lag + ROLL_PITCH, error_state.TORQUE_LAG, float(torque_roll > 0.0)),
        (RATES.torque_lag + YAW, error_state.TORQUE_LAG, float(torque_yaw > 0.0)),
        *((RATES.offset + k, error_state.OFFSET, share) for k in range(2)),
        *((RATES.offset_by_thrust + k, error_state.OFFSET_BY_THRUST, share) for k in range(2)),
    ):
        rates.P[i, i], rates.x[i] = variances_at(assumed, scale)
    rates.x[RATES.rate : RATES.acceleration] = _RATE_PROCESS_NOISE**2
    rates.x[RATES.acceleration : RATES.lag] = _ACCELERATION_PROCESS_NOISE**2
    # Late odometry looks like a lag; compensating a lag that does not exist oscillates. So the
    # longest lag is closer to the configured one for quick vehicles.
    longest = error_state.LONGEST_RATE_LAG - 1.0
    state.longest_rate_lag = 1.0 + longest / bandwidth_scale


def set_accelerometer_variances(state: Filter) -> None:
    """Write the variances of the accelerometer's bias; without accelerometer they are 0."""
    translation = state.process_noise.translation
    for i in range(MOTION.accelerometer, MOTION.size):
        translation.P[i, i], translation.x[i] = variances_at(error_state.ACCELEROMETER)


def bandwidth_scale_of(nominal: ModelParameters, delay: float) -> float:
    """Return the estimator's bandwidth relative to the default, at least 1.

    Commands respond to the estimate, and a loop faster than the actuators oscillates.
    """
    roll, pitch, _yaw = nominal.rate_time_constants
    latency = max(roll, pitch) + nominal.thrust_time_constant + delay
    if latency <= _DEFAULT_LATENCY / math.sqrt(_MAX_BANDWIDTH_SCALE):
        return _MAX_BANDWIDTH_SCALE
    return float(max((_DEFAULT_LATENCY / latency) ** 2, 1.0))

"""What is assumed of each state at the start, by the configured parameters."""

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

_RATE_WALK = 0.2  # rad/s / sqrt(s), of the model's rates
# From a command to what it does by default [s], and by how much closer at most vehicles are
# followed that answer sooner.
_USUAL_LATENCY, _CLOSEST = 0.13, 4.0


def assume(state: Filter, closer: float) -> None:
    """Write what is assumed of each state, by the configured parameters."""
    nominal = state.nominal
    translation, rates = state.process_noise.translation, state.process_noise.rates
    roll, pitch, yaw = nominal.rate_time_constants.tolist()
    shared = 0.5 * (roll + pitch)
    # An offset that is found soon makes a loop as quick: only where short lags are configured.
    share = min(closer - 1.0, 1.0) if max(roll, pitch, yaw) > 0.0 else 0.0
    d, of_lag = MOTION.disturbance, error_state.LAG
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
        (ROLL_PITCH, of_lag, shared),
        (YAW, error_state.YAW_LAG, yaw),
        *((RATES.offset + k, error_state.OFFSET, share) for k in range(2)),
        *((RATES.offset_by_thrust + k, error_state.OFFSET_BY_THRUST, share) for k in range(2)),
        (RATES.lateness, error_state.LATENESS, share),
    ):
        rates.P[i, i], rates.x[i] = variances_at(assumed, scale)
    rates.x[RATES.rate : RATES.lag] = _RATE_WALK**2
    # Shorter lags are trusted more: a lag that is learned although it is none, of odometry that
    # is late, is answered by commands that lead more, and oscillates.
    lags, shortest = state.rate_lags, error_state.SHORTEST_RATE_LAG
    lags.share[:] = roll / (shared or 1.0), pitch / (shared or 1.0), yaw / (yaw or 1.0)
    lags.shortest[:] = shortest * shared, shortest * shared, shortest * yaw
    slowest = (1.0 + 1.0 / closer) * shared
    lags.longest[:] = slowest, slowest, error_state.SLOWEST_YAW * yaw


def assume_accelerometer(state: Filter) -> None:
    """Write what is assumed of an accelerometer; without one it is known to have no bias."""
    translation = state.process_noise.translation
    for i in range(MOTION.accelerometer, MOTION.size):
        translation.P[i, i], translation.x[i] = variances_at(error_state.ACCELEROMETER)


def closeness(nominal: ModelParameters, delay: float) -> float:
    """Return by how much closer than usual a vehicle is followed, 1 at least.

    What is learned is answered by commands, and a loop that is quicker than the actuators
    oscillates. Where they are as quick as the default's it is as usual. No lag is a lag of 0.
    """
    roll, pitch, _yaw = nominal.rate_time_constants
    latency = max(roll, pitch) + nominal.thrust_time_constant + delay
    if latency <= _USUAL_LATENCY / math.sqrt(_CLOSEST):
        return _CLOSEST
    return float(max((_USUAL_LATENCY / latency) ** 2, 1.0))

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The states of the filter, its record, and the model parameters derived from the record.

The attitude is measured, so translation and body rates are not coupled and have separate filters.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3, Vector4
from quad_mpc_ros.control.estimation.loop_rates import LoopRates
from quad_mpc_ros.control.estimation.measurement_noise import VelocityDrift, WhiteNoise
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.parameters import ModelParameters


class MotionIndices(NamedTuple):
    """Indices of the blocks of the translation filter, and its size."""

    position: int  # m, in the world
    velocity: int  # m/s, in the world
    disturbance: int  # m/s^2, in the world
    scale: int  # of the thrust
    lag: int  # s, of the thrust: its time constant, and a delay beyond the longest one
    drag: int  # 1/s, the mean over the axes
    throttle: int
    bias: int  # m/s, measured less true velocity
    accelerometer: int  # m/s^2, in the body, measured less true specific force
    size: int


class RateIndices(NamedTuple):
    """Indices of the blocks of the rate filter, and its size."""

    rate: int  # rad/s, of the model
    acceleration: int  # rad/s^2, of the model
    lag: int  # logarithms of the factors on the time constants: of roll and pitch, and of yaw
    torque_lag: int  # the same of the time constants of the torque
    offset: int  # rad/s, of roll and pitch from their commands
    offset_by_thrust: int  # rad/s per m/s^2 of the modelled specific thrust
    size: int


MOTION = MotionIndices(0, 3, 6, 9, 10, 11, 12, 13, 16, 19)
RATES = RateIndices(0, 3, 6, 8, 10, 12, 14)
ROLL_PITCH, YAW = 0, 1
"""Positions in the blocks of time constants."""

# Learned states of the translation filter, first and end.
LEARNED_STATES = MOTION.disturbance, MOTION.throttle


class TranslationEstimate(Record):
    """Estimate and covariance of the translation filter."""

    x: Annotated[Array, (MOTION.size,)]
    P: Annotated[Array, (MOTION.size, MOTION.size)]


class RateEstimate(Record):
    """Estimate and covariance of the rate filter."""

    x: Annotated[Array, (RATES.size,)]
    P: Annotated[Array, (RATES.size, RATES.size)]


class StateNoise(NamedTuple):
    """Initial standard deviation, and random walk per square root of a second."""

    initial: float
    random_walk: float


DISTURBANCE = StateNoise(1.0, 0.7)  # horizontal; m/s^2
# The vertical disturbance decays within seconds: what lasts longer is a thrust error.
VERTICAL = StateNoise(0.5, 0.3)
VERTICAL_TIME = 4.0  # s
SCALE = StateNoise(0.2, 0.015)
RATE_LAG = StateNoise(0.7, 0.15)  # of the logarithms of the rates' time constants
TORQUE_LAG = StateNoise(0.9, 0.15)
THRUST_LAG = StateNoise(1.0, 0.1)  # includes unmodelled delay
DRAG = StateNoise(0.3, 0.05)  # 1/s
OFFSET = StateNoise(0.3, 0.06)
OFFSET_BY_THRUST = StateNoise(0.05, 0.001)
ACCELEROMETER = StateNoise(0.3, 0.01)  # m/s^2, bias and tilt of its mounting

DIFFERENCE = 1e-6  # of states, for the Jacobians of predictions

VERTICAL_BOUND = 3.0  # m/s^2
SCALE_BOUNDS = (0.5, 1.5)
SHORTEST_THRUST_LAG, LONGEST_THRUST_LAG = 0.2, 2.0  # factors on the thrust's time constant
# Factors on the rates' time constants: quick and slow rate loops with the default of 70 ms, and
# delays shorter than configured.
SHORTEST_RATE_LAG, LONGEST_RATE_LAG = 0.05, 8.0
TORQUE_LAG_FACTOR = 10.0  # on the torque's time constants, either way
MAX_THRUST_DELAY = 0.1  # s, beyond its longest time constant
DRAG_FACTORS, MIN_DRAG_MARGIN = (0.1, 3.0), 0.8  # of the configured drag, and 1/s beyond it
OFFSET_BOUND, OFFSET_BY_THRUST_BOUND = 3.0, 0.2


def variances_at(assumed: StateNoise, scale: float = 1.0) -> tuple[float, float]:
    """Return the initial variance and its growth per second of a state, times ``scale``."""
    return float(np.square(scale * assumed.initial)), float(np.square(scale * assumed.random_walk))


class Bounds(Record):
    """Bounds of commands and estimate."""

    throttle_min: float
    throttle_max: float
    disturbance_max: float  # m/s^2, along the ground


class ProcessNoise(Record):
    """Growth of the variance per second (x), and initial variance (diagonal of P)."""

    translation: TranslationEstimate
    rates: RateEstimate


class LowpassedRates(Record):
    """Commands and measured rates after equal first-order low-pass filters."""

    command: Vector4
    measured: Vector3  # rad/s
    last: Vector3  # rad/s, previous measurement, unfiltered
    change: Vector3  # rad/s, between the last two measurements
    skipped: int  # whether the last measurement was an outlier


class SpecificForce(Record):
    """The mean specific force between two odometries, and the result of its update."""

    f_B: Vector3  # m/s^2
    variance: float  # m^2/s^4 along each axis, 0 without measurement
    nis: float  # last normalised innovation squared, of 3 degrees of freedom
    used: int  # whether the last measurement was used


class Filter(Record):
    """State and configuration of the filter."""

    translation: TranslationEstimate
    rates: RateEstimate
    process_noise: ProcessNoise
    position_noise: WhiteNoise
    velocity_noise: WhiteNoise
    drift: VelocityDrift
    nominal: ModelParameters  # as configured
    estimated: ModelParameters
    drag_shape: Vector3  # anisotropic drag over the mean drag
    latency_uncertainty: float  # s, configured half of the 95 % interval; rises if refuted
    known_loop_scale: float  # factor on the weights of the rates if the loop explains the rates
    longest_rate_lag: float  # factor on the time constants of roll and pitch
    lowpass: LowpassedRates
    loop: LoopRates  # of the estimated loop
    bounds: Bounds
    enabled: int  # whether parameters are estimated
    paused_for: float  # s, how long the velocity alone has been estimated
    position_nis: float  # last normalised innovation squared, of 3 degrees of freedom
    specific_force: SpecificForce  # between the last two odometries


@compiled
def loop_lags(state: Filter, axis: int) -> tuple[float, float]:
    """Return the estimated time constants of the rate loop and of the torque of an axis [s]."""
    x, nominal, k = state.rates.x, state.nominal, YAW if axis == 2 else ROLL_PITCH
    rate, torque = nominal.rate_time_constants[axis], nominal.torque_time_constants[axis]
    return rate * math.exp(x[RATES.lag + k]), torque * math.exp(x[RATES.torque_lag + k])


@compiled
def write_estimated(state: Filter) -> None:
    """Write the estimated parameters; all others stay as configured."""
    x, rates, parameters = state.translation.x, state.rates.x, state.estimated
    shape, nominal = state.drag_shape, state.nominal
    learned = x[MOTION.drag] - nominal.drag
    longest = LONGEST_THRUST_LAG * nominal.thrust_time_constant
    parameters.thrust_time_constant = min(x[MOTION.lag], longest)
    parameters.thrust_time_constant_down = parameters.thrust_time_constant
    if nominal.thrust_time_constant > 0.0:
        ratio = nominal.thrust_time_constant_down / nominal.thrust_time_constant
        parameters.thrust_time_constant_down *= ratio
    parameters.thrust_scale = x[MOTION.scale]
    parameters.drag = x[MOTION.drag]
    for k in range(3):
        parameters.a_W[k] = x[MOTION.disturbance + k]
        anisotropic = learned * shape[k]
        parameters.learned_drag[k] = learned + anisotropic
        parameters.anisotropic_drag[k] = nominal.anisotropic_drag[k] + anisotropic
        parameters.rate_time_constants[k], parameters.torque_time_constants[k] = loop_lags(
            state, k
        )
    for k in range(2):
        parameters.rate_offset[k] = rates[RATES.offset + k]
        parameters.rate_offset_by_thrust[k] = rates[RATES.offset_by_thrust + k]


@compiled
def is_at_bounds(state: Filter) -> bool:
    """Whether disturbance or thrust scale is at a bound."""
    x, farthest = state.translation.x, state.bounds.disturbance_max
    d, k = MOTION.disturbance, x[MOTION.scale]
    far = max(abs(x[d]), abs(x[d + 1])) >= farthest or abs(x[d + 2]) >= VERTICAL_BOUND
    return bool(far or not SCALE_BOUNDS[0] < k < SCALE_BOUNDS[1])

"""The record of the filter, and the model parameters derived from the record."""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3, Vector4
from quad_mpc_ros.control.estimation import error_state
from quad_mpc_ros.control.estimation.error_state import (
    MOTION,
    RATES,
    ROLL_PITCH,
    SCALE_BOUNDS,
    VERTICAL_BOUND,
    YAW,
    RateEstimate,
    TranslationEstimate,
)
from quad_mpc_ros.control.estimation.measurement_noise import VelocityDrift, WhiteNoise
from quad_mpc_ros.control.estimation.specific_force import SpecificForce
from quad_mpc_ros.control.model.parameters import ModelParameters


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
    longest_rate_lag: float  # factor on the time constants of roll and pitch
    lowpass: LowpassedRates
    bounds: Bounds
    enabled: int  # whether parameters are estimated
    paused_for: float  # s, how long the velocity alone has been estimated
    # Normalised innovations squared of the last odometry, of 3 degrees of freedom each.
    position_nis: float
    velocity_nis: float
    velocity_innovation: Vector3  # m/s
    specific_force: SpecificForce  # between the last two odometries


@compiled
def loop_lags(state: Filter, axis: int) -> tuple[float, float]:
    """Return the estimated time constants of the rate loop and of the torque of an axis [s]."""
    x, nominal, k = state.rates.x, state.nominal, YAW if axis == 2 else ROLL_PITCH
    rate, torque = nominal.rate_time_constants[axis], nominal.torque_time_constants[axis]
    return rate * math.exp(x[RATES.lag + k]), torque * math.exp(x[RATES.torque_lag + k])


@compiled
def write_estimated(state: Filter, parameters: ModelParameters) -> None:
    """Write the estimated parameters."""
    x, rates = state.translation.x, state.rates.x
    shape, nominal = state.drag_shape, state.nominal
    learned = x[MOTION.drag] - nominal.drag
    parameters.a, parameters.b, parameters.c = nominal.a, nominal.b, nominal.c
    parameters.gravity = nominal.gravity
    parameters.translational_lift = nominal.translational_lift
    longest = error_state.LAG_FACTOR * nominal.thrust_time_constant
    parameters.thrust_time_constant = min(x[MOTION.lag], longest)
    parameters.thrust_time_constant_down = parameters.thrust_time_constant
    if nominal.thrust_time_constant > 0.0:
        ratio = nominal.thrust_time_constant_down / nominal.thrust_time_constant
        parameters.thrust_time_constant_down *= ratio
    parameters.thrust_scale = x[MOTION.scale]
    parameters.drag = x[MOTION.drag]
    for k in range(3):
        parameters.rotor_drag[k] = nominal.rotor_drag[k]
        parameters.a_W[k] = x[MOTION.disturbance + k]
        anisotropic = learned * shape[k]
        parameters.learned_drag[k] = learned + anisotropic
        parameters.anisotropic_drag[k] = nominal.anisotropic_drag[k] + anisotropic
        parameters.rate_time_constants[k], parameters.torque_time_constants[k] = loop_lags(
            state, k
        )
        parameters.angular_acceleration_max[k] = nominal.angular_acceleration_max[k]
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

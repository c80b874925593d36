"""The states of the filter: indices, initial deviations, process noise and bounds.

The attitude is measured, so translation and body rates are not coupled and have separate filters.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from quad_mpc_ros.configuration.records import Record
from quad_mpc_ros.control.lie import Array


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

VERTICAL_BOUND = 3.0  # m/s^2
SCALE_BOUNDS = (0.5, 1.5)
LAG_FACTOR = 2.0  # of the thrust's time constant, either way
# Factors on the rates' time constants: racers and slow rate loops with the default of 70 ms.
SHORTEST_RATE_LAG, LONGEST_RATE_LAG = 0.2, 8.0
TORQUE_LAG_FACTOR = 10.0  # on the torque's time constants, either way
MAX_THRUST_DELAY = 0.1  # s, beyond its longest time constant
DRAG_FACTORS, MIN_DRAG_MARGIN = (0.1, 3.0), 0.8  # of the configured drag, and 1/s beyond it
OFFSET_BOUND, OFFSET_BY_THRUST_BOUND = 3.0, 0.2


def variances_at(assumed: StateNoise, scale: float = 1.0) -> tuple[float, float]:
    """Return the initial variance and its growth per second of a state, times ``scale``."""
    return float(np.square(scale * assumed.initial)), float(np.square(scale * assumed.random_walk))

"""The state of the filter: its blocks by name, and what is assumed of each.

Attitude is measured, so no noise and no equation of motion couples what turns the vehicle with
what moves it: the covariance has two blocks on its diagonal, which are kept apart.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from quad_mpc_ros.configuration.records import Record
from quad_mpc_ros.control.lie import Array


class MotionIndices(NamedTuple):
    """Where in the state of the motion each block begins, and its size."""

    position: int  # m, in the world
    velocity: int  # m/s, in the world
    disturbance: int  # m/s^2, in the world
    scale: int  # of the thrust
    lag: int  # s, by which the thrust is behind: a time constant, and a delay beyond its longest
    drag: int  # 1/s, the mean over the axes
    throttle: int
    bias: int  # m/s, what the measured velocity has beyond the true one
    accelerometer: int  # m/s^2, in the body, what an accelerometer has beyond the true force
    size: int


class RateIndices(NamedTuple):
    """Where in the state of the body rates each block begins, and its size."""

    rate: int  # rad/s, of the model
    lag: int  # s, the time constants: that of roll and pitch, their mean, and that of yaw
    offset: int  # rad/s, of roll and pitch beyond their commands
    offset_by_thrust: int  # rad/s per m/s^2 of the thrust that the model makes of the throttle
    lateness: int  # s, by which roll and pitch answer later than by their time constant
    size: int


MOTION = MotionIndices(0, 3, 6, 9, 10, 11, 12, 13, 16, 19)
RATES = RateIndices(0, 3, 5, 7, 9, 10)
ROLL_PITCH, YAW = RATES.lag, RATES.lag + 1

# What is learned of the vehicle by its motion, from the first to before the last.
LEARNED_STATES = MOTION.disturbance, MOTION.throttle


class TranslationEstimate(Record):
    """Estimate and covariance of the motion."""

    x: Annotated[Array, (MOTION.size,)]
    P: Annotated[Array, (MOTION.size, MOTION.size)]


class RateEstimate(Record):
    """Estimate and covariance of the body rates."""

    x: Annotated[Array, (RATES.size,)]
    P: Annotated[Array, (RATES.size, RATES.size)]


class Assumed(NamedTuple):
    """Standard deviation at the start, and walk per root of a second."""

    spread: float
    walk: float


DISTURBANCE = Assumed(1.0, 0.7)  # along the ground; m/s^2
# Upwards it is correlated over some seconds: what lasts for longer is a matter of the thrust.
VERTICAL = Assumed(0.5, 0.3)
VERTICAL_TIME = 4.0  # s
SCALE = Assumed(0.2, 0.015)
LAG = Assumed(0.5, 0.1)  # of the time constants, as shares of what is configured
THRUST_LAG = Assumed(1.0, 0.1)  # a delay that is not modelled is taken for a lag
YAW_LAG = Assumed(1.5, 0.1)  # yaw is turned by drag of the rotors, several times slower as a rule
DRAG = Assumed(0.3, 0.05)  # 1/s
OFFSET = Assumed(0.3, 0.06)
OFFSET_BY_THRUST = Assumed(0.05, 0.001)
LATENESS = Assumed(0.01, 0.01)
ACCELEROMETER = Assumed(0.3, 0.01)  # m/s^2, its bias, and what its mounting leans by

VERTICAL_BOUND = 3.0  # m/s^2
SCALE_BOUNDS = (0.5, 1.5)
LAG_FACTOR = 2.0  # of the thrust's time constant, either way
SHORTEST_RATE_LAG = 0.2  # of the rates' time constants: a racer's where the default expects 70 ms
LATEST = 0.1  # s, by which the thrust is later than by its longest time constant
SLOWEST_YAW = 6.0  # factor on its time constant
DRAG_FACTORS, DRAG_MORE = (0.1, 3.0), 0.8  # of the configured drag, and 1/s beyond it at least
OFFSET_BOUND, OFFSET_BY_THRUST_BOUND = 3.0, 0.2


def variances_at(assumed: Assumed, scale: float = 1.0) -> tuple[float, float]:
    """Return the variance at the start and its growth per second, of a state times ``scale``."""
    return float(np.square(scale * assumed.spread)), float(np.square(scale * assumed.walk))

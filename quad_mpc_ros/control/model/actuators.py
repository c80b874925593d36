"""First-order lags of throttle and body rates, in compiled code.

An actuator y follows its command c as dy/dt = (c - y) / tau. After a time t under one command the
share exp(-t / tau) of its distance to the command remains, on average over that time the share tau
(1 - exp(-t / tau)) / t. Without a time constant the actuator equals its command.

The simulator implements the lag independently (``simulation/motion.py``), so that tests find
errors.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import U_RATE, U_THROTTLE

Actuators = tuple[float, float, float, float]
"""Throttle and body rates [rad/s]."""


@compiled
def actuators_in(u: Array) -> Actuators:
    """Return throttle and rates (4,) as plain numbers."""
    return u[U_THROTTLE], u[U_RATE], u[U_RATE + 1], u[U_RATE + 2]


@compiled
def first_order_lag(time_constant: float, duration: float) -> tuple[float, float]:
    """Return the remaining share of the distance to the command, at the end and on average."""
    if time_constant <= 0.0:
        return 0.0, 0.0
    decay = math.exp(-duration / time_constant)
    return decay, time_constant * (1.0 - decay) / duration


@compiled
def first_order_lag_slopes(time_constant: float, duration: float) -> tuple[float, float]:
    """Return the derivatives of :func:`first_order_lag` with respect to the time constant."""
    if time_constant <= 0.0:
        return 0.0, 0.0
    decay, share = first_order_lag(time_constant, duration)
    decay_slope = decay * duration / time_constant**2
    return decay_slope, share / time_constant - time_constant * decay_slope / duration


@compiled
def inverse_lag(time_constant: float, duration: float, before: float, after: float) -> float:
    """Return the command c = y + tau dy/dt that takes a lagging actuator between two values."""
    return 0.5 * (before + after) + time_constant / duration * (after - before)

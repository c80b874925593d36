"""First-order lags of throttle and body rates, in compiled code.

An actuator y follows its command c as dy/dt = (c - y) / tau. After a time t under one command it
has kept exp(-t / tau) of its distance to the command, and on the average over that time
tau (1 - exp(-t / tau)) / t of it. Without a time constant it is its command.

The plant of the simulator has a lag of its own (``simulation/actuators.py``), on purpose: a
mistake that both shared would not show.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import U_RATE, U_THROTTLE

Actuators = tuple[float, float, float, float]
"""Throttle and body rates [rad/s], or one number for each of them."""


@compiled
def actuators_in(u: Array) -> Actuators:
    """Return throttle and rates (4,) as plain numbers."""
    return u[U_THROTTLE], u[U_RATE], u[U_RATE + 1], u[U_RATE + 2]


@compiled
def first_order_lag(time_constant: float, duration: float) -> tuple[float, float]:
    """Return which share of the distance to the command is kept, at the end and on average."""
    if time_constant <= 0.0:
        return 0.0, 0.0
    decay = math.exp(-duration / time_constant)
    return decay, time_constant * (1.0 - decay) / duration


@compiled
def first_order_lag_slopes(time_constant: float, duration: float) -> tuple[float, float]:
    """Return the derivatives of :func:`first_order_lag` by the time constant."""
    if time_constant <= 0.0:
        return 0.0, 0.0
    decay, share = first_order_lag(time_constant, duration)
    decay_slope = decay * duration / time_constant**2
    return decay_slope, share / time_constant - time_constant * decay_slope / duration


@compiled
def inverse_lag(time_constant: float, duration: float, before: float, after: float) -> float:
    """Return the command that takes a lagging actuator from one value to another.

    The inverse of the lag, c = y + tau dy/dt, half way.
    """
    return 0.5 * (before + after) + time_constant / duration * (after - before)


@compiled
def followed(kept: Actuators, y: Actuators, command: Actuators) -> Actuators:
    """Return what is between actuators and their command when a share of the distance is kept."""
    throttle, roll, pitch, yaw = command
    of_throttle, of_roll, of_pitch, of_yaw = kept
    at_throttle, at_roll, at_pitch, at_yaw = y
    return (
        throttle + of_throttle * (at_throttle - throttle),
        roll + of_roll * (at_roll - roll),
        pitch + of_pitch * (at_pitch - pitch),
        yaw + of_yaw * (at_yaw - yaw),
    )

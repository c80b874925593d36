# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Lags of throttle and body rates, in compiled code.

An actuator y follows its command c as dy/dt = (c - y) / tau. After a time t under one command the
share exp(-t / tau) of its distance to the command remains, on average over that time the share tau
(1 - exp(-t / tau)) / t. Without a time constant the actuator equals its command.

The rate loop of an axis is a gain followed by a torque lag. With the commanded rate w_c, the gain
1 / tau and the lag T of the torque,

    dw/dt = alpha,    T dalpha/dt = clamp((w_c - w) / tau, -alpha_max, alpha_max) - alpha.

The natural frequency is 1 / sqrt(tau T), the damping ratio sqrt(tau / T) / 2. A gain D on the
angular acceleration divides both tau and T by 1 + D. Without T the rate lags by tau alone.

The simulator implements both independently (``simulation/motion.py``), so that tests find
errors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

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
def inverse_lag(time_constant: float, duration: float, before: float, after: float) -> float:
    """Return the command c = y + tau dy/dt that takes a lagging actuator between two values."""
    return 0.5 * (before + after) + time_constant / duration * (after - before)


class LoopResponse(NamedTuple):
    """Response of an axis over a step, linear in w - w_c and in alpha at its start.

    ``rate`` and ``rate_by_acceleration`` [s] give w - w_c at the end, ``mean`` and
    ``mean_by_acceleration`` [s] the mean of w - w_c, ``acceleration`` [1/s] and
    ``acceleration_by_acceleration`` to alpha at the end. ``reach`` [rad/s] is the largest distance
    to the command with which the mean of the demanded acceleration is within its bound.
    """

    rate: float
    rate_by_acceleration: float
    mean: float
    mean_by_acceleration: float
    acceleration: float
    acceleration_by_acceleration: float
    reach: float


class AxisStep(NamedTuple):
    """Mean rate over a step, and rate [rad/s] and acceleration [rad/s^2] at its end.

    For Jacobians, ``response`` is the applied response, and ``follows`` is 1, or 0 where the
    command has no effect because the demanded acceleration is at its bound.
    """

    mean: float
    rate: float
    acceleration: float
    response: LoopResponse
    follows: float


@compiled
def loop_step(tau: float, lag: float, acceleration_max: float, duration: float) -> LoopResponse:
    """Return the response over a duration [s]; ``tau`` and ``lag`` are tau and T [s].

    ``acceleration_max`` is alpha_max [rad/s^2], infinite without a bound.
    """
    if tau <= 0.0 or lag <= 0.0:
        decay, share = first_order_lag(tau, duration)
        return LoopResponse(decay, 0.0, share, 0.0, 0.0, 0.0, _reach(acceleration_max, tau, share))
    even, odd = _modes(tau, lag, duration)
    rate, acceleration = even + 0.5 * odd / lag, -odd / (tau * lag)
    fading = even - 0.5 * odd / lag
    # The integral of w - w_c, from the equation of alpha.
    mean = tau * (1.0 - rate - lag * acceleration) / duration
    by_acceleration = tau * (lag * (1.0 - fading) - odd) / duration
    reach = _reach(acceleration_max, tau, mean)
    return LoopResponse(rate, odd, mean, by_acceleration, acceleration, fading, reach)


@compiled
def _modes(tau: float, lag: float, duration: float) -> tuple[float, float]:
    """Return e^(m t) cosh(r t) and e^(m t) sinh(r t) / r of the roots m - r and m + r."""
    middle = -0.5 / lag
    square = middle * middle - 1.0 / (tau * lag)
    root = math.sqrt(abs(square))
    turned = root * duration
    if turned < 1e-4:
        decay = math.exp(middle * duration)
        change = square * duration * duration
        return decay * (1.0 + 0.5 * change), decay * duration * (1.0 + change / 6.0)
    if square < 0.0:
        decay = math.exp(middle * duration)
        return decay * math.cos(turned), decay * math.sin(turned) / root
    slow, fast = math.exp((middle + root) * duration), math.exp((middle - root) * duration)
    return 0.5 * (slow + fast), 0.5 * (slow - fast) / root


@compiled
def _reach(acceleration_max: float, tau: float, mean: float) -> float:
    return acceleration_max * tau / mean if mean > 0.0 else math.inf


@compiled
def axis_step(loop: LoopResponse, rate: float, acceleration: float, command: float) -> AxisStep:
    """Return an axis after a step under a command [rad/s]."""
    off, follows = rate - command, 1.0
    if abs(off) > loop.reach:
        off, follows = math.copysign(loop.reach, off), 0.0
        command = rate - off
    mean = command + loop.mean * off + loop.mean_by_acceleration * acceleration
    after = command + loop.rate * off + loop.rate_by_acceleration * acceleration
    faded = loop.acceleration_by_acceleration * acceleration
    faded += loop.acceleration * off
    if follows == 0.0:  # the demand at the bound moves with the rate
        loop = LoopResponse(
            1.0,
            loop.rate_by_acceleration,
            1.0,
            loop.mean_by_acceleration,
            0.0,
            loop.acceleration_by_acceleration,
            loop.reach,
        )
    return AxisStep(mean, after, faded, loop, follows)

"""Actuators of the plant: first-order lags, compiled.

Body rates and throttle y follow the command c as dy/dt = (c - y) / tau; without lag if tau is 0.
The throttle signal lags, the thrust follows from the curve.

The controller's model (``control/model/actuators.py``) is implemented independently, so that tests
find errors.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import kernels

ActuatorState = tuple[float, kernels.Vector]
"""Throttle and body rates [rad/s]."""

TimeConstants = tuple[float, kernels.Vector]
"""Time constants of the throttle and of each body rate [s]."""


@compiled
def thrust_at(throttle: float, curve: kernels.Vector) -> float:
    """Return the thrust at a throttle, in the units of its curve (highest power first)."""
    return (curve[0] * throttle + curve[1]) * throttle + curve[2]


@compiled
def later(
    u: ActuatorState, command: ActuatorState, lags: TimeConstants, duration: float
) -> ActuatorState:
    """Return the actuators after ``duration`` [s] under one command."""
    throttle, (x, y, z) = u
    to_throttle, (to_x, to_y, to_z) = command
    of_x, of_y, of_z = lags[1]
    return to_throttle + _kept(lags[0], duration) * (throttle - to_throttle), (
        to_x + _kept(of_x, duration) * (x - to_x),
        to_y + _kept(of_y, duration) * (y - to_y),
        to_z + _kept(of_z, duration) * (z - to_z),
    )


@compiled
def turn(
    w_WB_B: kernels.Vector,
    command: kernels.Vector,
    time_constants: kernels.Vector,
    duration: float,
) -> kernels.Matrix:
    """Return the rotation over ``duration`` [s] of body rates c + d exp(-t / tau) of each axis.

    The Magnus expansion of R' = R [omega] to its second term, both integrals in closed form: the
    integral of omega, and half that of omega(s) x omega(t) over s < t. What is left out is of
    order h^5 (Blanes, Casas, Oteo, Ros, "The Magnus expansion and some of its applications",
    2009; its sign of the second term is for R' = [omega] R).
    """
    h, (of_x, of_y, of_z) = duration, time_constants
    held = kernels.scaled(h, command)
    if of_x == of_y == of_z == 0.0:
        return kernels.exp(held)
    d = kernels.plus(w_WB_B, kernels.scaled(-1.0, command))
    if of_x == of_y == of_z:
        tau, decay = of_x, math.exp(-h / of_x)
        first = kernels.plus(held, kernels.scaled(tau * (1.0 - decay), d))
        second = tau * tau * (1.0 - decay) - 0.5 * tau * h * (1.0 + decay)
        return kernels.exp(kernels.plus(first, kernels.scaled(second, kernels.cross(command, d))))
    x, y, z = (command[0], d[0], of_x), (command[1], d[1], of_y), (command[2], d[2], of_z)
    return kernels.exp(
        (
            held[0] + d[0] * _gained(of_x, h) + 0.5 * (_ordered(y, z, h) - _ordered(z, y, h)),
            held[1] + d[1] * _gained(of_y, h) + 0.5 * (_ordered(z, x, h) - _ordered(x, z, h)),
            held[2] + d[2] * _gained(of_z, h) + 0.5 * (_ordered(x, y, h) - _ordered(y, x, h)),
        )
    )


@compiled
def _ordered(first: kernels.Vector, second: kernels.Vector, duration: float) -> float:
    """Return the integral of first(s) second(t) over 0 < s < t < duration.

    Each is c + d exp(-t / tau), given as (c, d, tau).
    """
    (c, d, tau), (to_c, to_d, to_tau) = first, second
    h, gained, to_gained = duration, _gained(tau, duration), _gained(to_tau, duration)
    both = tau * to_tau / (tau + to_tau) if tau > 0.0 and to_tau > 0.0 else 0.0
    held = c * (0.5 * to_c * h * h + to_d * (to_tau * to_gained - to_tau * h + h * to_gained))
    return held + d * tau * (to_c * (h - gained) + to_d * (to_gained - _gained(both, duration)))


@compiled
def _gained(time_constant: float, duration: float) -> float:
    """Return the integral of exp(-t / tau)."""
    return time_constant * (1.0 - _kept(time_constant, duration))


@compiled
def _kept(time_constant: float, duration: float) -> float:
    """Return the remaining share of the distance to the command."""
    return math.exp(-duration / time_constant) if time_constant > 0.0 else 0.0

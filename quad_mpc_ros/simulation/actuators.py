"""From the command in force to what the motors do: first-order lags, compiled.

Body rates and throttle y follow the command c as dy/dt = (c - y) / tau, with time constants in
seconds; with 0 the command is followed at once. It is the throttle signal that lags, the thrust
follows by the curve.

The plant's own, apart from those of the controller's model (``model/actuators.py``) on purpose: a
mistake that both shared would not show.
"""

from __future__ import annotations

import math

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import kernels

ActuatorState = tuple[float, kernels.Vector]
"""Throttle and body rates [rad/s]."""

TimeConstants = tuple[float, float]
"""Of the throttle and of the body rates [s]."""


@compiled
def later(
    u: ActuatorState, command: ActuatorState, lags: TimeConstants, duration: float
) -> ActuatorState:
    """Return the actuators after ``duration`` [s] under one command."""
    throttle, (x, y, z) = u
    to_throttle, (to_x, to_y, to_z) = command
    kept, kept_rate = _kept(lags[0], duration), _kept(lags[1], duration)
    return to_throttle + kept * (throttle - to_throttle), (
        to_x + kept_rate * (x - to_x),
        to_y + kept_rate * (y - to_y),
        to_z + kept_rate * (z - to_z),
    )


@compiled
def turn(
    w_WB_B: kernels.Vector, command: kernels.Vector, time_constant: float, duration: float
) -> kernels.Matrix:
    """Return the rotation over ``duration`` [s] of the body rate c + d exp(-t / tau).

    The Magnus expansion of R' = R [omega] to its second term, both integrals in closed form: the
    integral of omega, and half that of omega(s) x omega(t) over s < t. What is left out is of
    order h^5 (Blanes, Casas, Oteo, Ros, "The Magnus expansion and some of its applications",
    2009; its sign of the second term is for R' = [omega] R).
    """
    h, tau = duration, time_constant
    held = kernels.scaled(h, command)
    if tau == 0.0:
        return kernels.exp(held)
    d = kernels.plus(w_WB_B, kernels.scaled(-1.0, command))
    decay = math.exp(-h / tau)
    first = kernels.plus(held, kernels.scaled(tau * (1.0 - decay), d))
    second = tau * tau * (1.0 - decay) - 0.5 * tau * h * (1.0 + decay)
    return kernels.exp(kernels.plus(first, kernels.scaled(second, kernels.cross(command, d))))


@compiled
def _kept(time_constant: float, duration: float) -> float:
    """Return which share of the distance to the command is left."""
    return math.exp(-duration / time_constant) if time_constant > 0.0 else 0.0

"""Derivatives of the rollout with respect to model parameters, in compiled loops.

Position, velocity and throttle are differentiated with respect to the initial velocity and
throttle, by the disturbance, the thrust scale, the time constant of the thrust and the mean drag.
The drag of the axes is proportional to the mean. Body rates are differentiated with respect to the
time constants of their loops and the offsets. The derivatives belong to the discretisation in
:mod:`quad_mpc_ros.control.model.rollout`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import Actuators, first_order_lag_slopes
from quad_mpc_ros.control.model.jacobians import air_slopes, propagated_slopes
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.rate_loop import LoopResponse, loop_step
from quad_mpc_ros.control.model.rollout import (
    Body,
    Discretisation,
    Midpoint,
    discretised,
    substep,
    substeps_of,
)
from quad_mpc_ros.control.model.state import U_THROTTLE

_NEAR = 1.0 + 1e-5  # factor of difference quotients


class ParameterIndices(NamedTuple):
    """Rows of the derivatives with respect to velocity, throttle and parameters."""

    velocity: int
    disturbance: int
    scale: int
    lag: int
    drag: int
    throttle: int
    size: int


BY = ParameterIndices(velocity=0, disturbance=3, scale=6, lag=7, drag=8, throttle=9, size=10)


class MotionDerivatives(NamedTuple):
    """Derivatives of position and velocity (n, 3) and throttle (n,); rows as in :data:`BY`."""

    p: Array
    v: Array
    s: Array


@compiled
def no_motion() -> MotionDerivatives:
    """Return the derivatives at time 0: ones for velocity and throttle."""
    p, v, s = np.zeros((BY.size, 3)), np.zeros((BY.size, 3)), np.zeros(BY.size)
    for k in range(3):
        v[BY.velocity + k, k] = 1.0
    s[BY.throttle] = 1.0
    return MotionDerivatives(p, v, s)


@compiled
def propagated_with_derivatives(
    model: ModelParameters,
    drag_shape: kernels.Vector,
    command: Actuators,
    duration: float,
    x: Body,
    derivatives: MotionDerivatives,
) -> Body:
    """Return a state after a duration under a command, and propagate its derivatives.

    ``drag_shape`` is ``anisotropic_drag`` over the mean drag. The rates are constant.
    """
    count = substeps_of(duration)
    step = discretised(model, duration / count)
    for _ in range(count):
        x = _substep(model, drag_shape, step, command, x, derivatives)
    return x


@compiled
def _substep(
    model: ModelParameters,
    drag_shape: kernels.Vector,
    step: Discretisation,
    command: Actuators,
    x: Body,
    derivatives: MotionDerivatives,
) -> Body:
    """Return a state after a substep."""
    after, midpoint = substep(model, step, command, x)
    slopes = thrust_lag_slopes(model, x.actuators[U_THROTTLE], command[U_THROTTLE], step.dt)
    air = air_slopes(model, step, midpoint)
    z, off = kernels.column(midpoint.R, 2), x.actuators[U_THROTTLE] - command[U_THROTTLE]
    thrust_slope = model.thrust_scale * (2.0 * model.a * midpoint.throttle + model.b)
    p, v, s = derivatives
    for n in range(BY.size):
        mean = midpoint.lag[1] * s[n]
        s[n] *= midpoint.lag[0]
        if n == BY.lag:
            mean += slopes[1] * off
            s[n] += slopes[0] * off
        thrust = thrust_slope * mean
        if n == BY.scale:
            thrust += midpoint.specific_thrust / model.thrust_scale
        acceleration, direct = kernels.scaled(thrust, z), kernels.scaled(thrust, air.by_thrust)
        if n == BY.drag and air.anisotropic:
            slowed, taken = _slowed(drag_shape, step, x, midpoint)
            by_air = kernels.plus(kernels.apply(air.by_v, slowed), taken)
            direct = kernels.plus(direct, by_air)
        k = n - BY.disturbance
        if 0 <= k <= 2:
            acceleration = _axis(k)
        moved = kernels.vector(v[n]), kernels.vector(p[n])
        v_after, p_after = propagated_slopes(step, air, acceleration, direct, moved)
        kernels.store_vector(v_after, v[n])
        kernels.store_vector(p_after, p[n])
    _add_decay_slopes(model, step, (x, after), derivatives)
    return after


@compiled
def thrust_lag_slopes(
    model: ModelParameters, throttle: float, command: float, duration: float
) -> tuple[float, float]:
    """Return the derivatives of the thrust lag w.r.t. its time constant, rising or falling.

    The two time constants are proportional.
    """
    if throttle <= command or model.thrust_time_constant <= 0.0:
        return first_order_lag_slopes(model.thrust_time_constant, duration)
    ratio = model.thrust_time_constant_down / model.thrust_time_constant
    decay, share = first_order_lag_slopes(model.thrust_time_constant_down, duration)
    return ratio * decay, ratio * share


@compiled
def _axis(k: int) -> kernels.Vector:
    """Return the unit vector along axis k."""
    return (1.0 if k == 0 else 0.0), (1.0 if k == 1 else 0.0), (1.0 if k == 2 else 0.0)


@compiled
def _slowed(
    shape: kernels.Vector, step: Discretisation, x: Body, midpoint: Midpoint
) -> tuple[kernels.Vector, kernels.Vector]:
    """Return the derivatives of midpoint velocity and anisotropic drag w.r.t. the mean drag."""
    u = midpoint.v_B
    taken = -shape[0] * u[0], -shape[1] * u[1], -shape[2] * u[2]
    return kernels.scaled(-0.5 * step.dt, x.v), kernels.apply(midpoint.R, taken)


@compiled
def _add_decay_slopes(
    model: ModelParameters,
    step: Discretisation,
    states: tuple[Body, Body],
    derivatives: MotionDerivatives,
) -> None:
    """Add the derivatives of the exact integrals with respect to the mean drag.

    ``states`` are the states before and after the substep.
    """
    before, after = states
    dt, x = step.dt, model.drag * step.dt
    # Derivatives of the series of phi1 and phi2.
    phi1_slope = dt * dt * (-0.5 + x / 3.0 - x * x / 8.0 + x**3 / 30.0)
    phi2_slope = dt**3 * (-1.0 / 6.0 + x / 12.0 - x * x / 40.0 + x**3 / 180.0)
    for k in range(3):
        v = before.v[k]
        a = (after.v[k] - step.velocity_decay * v) / step.phi1
        derivatives.v[BY.drag, k] += phi1_slope * a - dt * step.velocity_decay * v
        derivatives.p[BY.drag, k] += phi1_slope * v + phi2_slope * a


@compiled
def at_start() -> Array:
    """Return the derivatives of rate and acceleration of an axis (2, 6) at time 0.

    Columns: rate, acceleration, logarithms of the time constants of loop and torque, offset of
    the command, and offset per thrust.
    """
    D = np.zeros((2, 6))
    D[0, 0] = D[1, 1] = 1.0
    return D


@compiled
def followed_loop(
    lags: tuple[float, float],
    command: tuple[float, float],
    duration: float,
    x: tuple[float, float],
    D: Array,
) -> tuple[float, float]:
    """Return rate and acceleration ``x`` of an axis after a duration, and propagate D (2, 6).

    ``lags`` are the time constants of loop and torque [s], ``command`` is the commanded rate with
    its offset [rad/s] and the modelled thrust [m/s^2] of the offset per thrust. Derivatives with
    respect to the time constants are difference quotients of the exact response.
    """
    off, loop = x[0] - command[0], loop_step(lags[0], lags[1], math.inf, duration)
    after = _after(loop, off, x[1])
    by_rate = _after(loop_step(_NEAR * lags[0], lags[1], math.inf, duration), off, x[1])
    by_torque = _after(loop_step(lags[0], _NEAR * lags[1], math.inf, duration), off, x[1])
    for n in range(6):
        w, acceleration = _after(loop, D[0, n], D[1, n])
        D[0, n], D[1, n] = w, acceleration
    for i in range(2):
        D[i, 2] += (by_rate[i] - after[i]) / (_NEAR - 1.0)
        D[i, 3] += (by_torque[i] - after[i]) / (_NEAR - 1.0)
    follows, accelerates = 1.0 - loop.rate, -loop.acceleration
    for n, factor in ((4, 1.0), (5, command[1])):
        D[0, n] += factor * follows
        D[1, n] += factor * accelerates
    return command[0] + after[0], after[1]


@compiled
def _after(loop: LoopResponse, off: float, acceleration: float) -> tuple[float, float]:
    """Return the distance to the command and the acceleration after a step."""
    return (
        loop.rate * off + loop.rate_by_acceleration * acceleration,
        loop.acceleration * off + loop.acceleration_by_acceleration * acceleration,
    )

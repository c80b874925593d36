"""Derivatives of the rollout by the parameters of the model, in compiled loops.

Position, velocity and throttle are differentiated by the initial velocity and throttle, by the
disturbance, the thrust scale, the time constant of the thrust and the mean drag. The drag of the
axes is proportional to the mean. Body rates are differentiated by their time constants and
offsets. The derivatives are those of the discretisation in
:mod:`quad_mpc_ros.control.model.rollout`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import (
    Actuators,
    first_order_lag,
    first_order_lag_slopes,
)
from quad_mpc_ros.control.model.jacobians import air_slopes, propagated_slopes
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.rollout import (
    Body,
    Discretisation,
    Midpoint,
    discretised,
    substep,
)
from quad_mpc_ros.control.model.state import U_THROTTLE


class ParameterIndices(NamedTuple):
    """Rows of the derivatives by velocity, throttle and parameters."""

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


class RateDerivatives(NamedTuple):
    """Derivatives of a body rate by initial rate, time constant and both offsets."""

    by_rate: float
    by_lag: float
    by_offset: float
    by_offset_by_thrust: float


OF_NO_TIME = RateDerivatives(1.0, 0.0, 0.0, 0.0)
"""The derivatives over no time."""


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
    longest: float,
    x: Body,
    derivatives: MotionDerivatives,
) -> Body:
    """Return a state after a duration under a command, and propagate its derivatives.

    Substeps last at most ``longest`` [s]. ``drag_shape`` is ``anisotropic_drag`` over the mean
    drag. The rates are constant.
    """
    count = max(1, math.ceil(duration / longest - 1e-9))
    step = discretised(model, duration / count)
    slopes = first_order_lag_slopes(model.thrust_time_constant, step.dt)
    for _ in range(count):
        x = _substep(model, drag_shape, step, slopes, command, x, derivatives)
    return x


@compiled
def _substep(
    model: ModelParameters,
    drag_shape: kernels.Vector,
    step: Discretisation,
    slopes: tuple[float, float],
    command: Actuators,
    x: Body,
    derivatives: MotionDerivatives,
) -> Body:
    """Return a state after a substep; ``slopes`` are derivatives of the thrust lag."""
    after, midpoint = substep(model, step, command, x)
    air = air_slopes(model, step, midpoint)
    z, off = kernels.column(midpoint.R, 2), x.actuators[U_THROTTLE] - command[U_THROTTLE]
    thrust_slope = model.thrust_scale * (2.0 * model.a * midpoint.mean[U_THROTTLE] + model.b)
    p, v, s = derivatives
    for n in range(BY.size):
        mean = step.share[0] * s[n]
        s[n] *= step.decay[0]
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
def _axis(k: int) -> kernels.Vector:
    """Return the unit vector along axis k."""
    return (1.0 if k == 0 else 0.0), (1.0 if k == 1 else 0.0), (1.0 if k == 2 else 0.0)


@compiled
def _slowed(
    shape: kernels.Vector, step: Discretisation, x: Body, midpoint: Midpoint
) -> tuple[kernels.Vector, kernels.Vector]:
    """Return the derivatives of midpoint velocity and anisotropic drag by the mean drag."""
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
    """Add the derivatives of the exact integrals by the mean drag.

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
def followed_rate(
    time_constant: float,
    command: float,
    thrust: float,
    duration: float,
    rate: float,
    derivatives: RateDerivatives,
) -> tuple[float, RateDerivatives]:
    """Return a body rate after a duration under a command, and its derivatives.

    The command includes the offset at the modelled ``thrust`` [m/s^2].
    """
    decay, _share = first_order_lag(time_constant, duration)
    slope, _share_slope = first_order_lag_slopes(time_constant, duration)
    off = rate - command
    return command + decay * off, RateDerivatives(
        decay * derivatives.by_rate,
        decay * derivatives.by_lag + slope * off,
        1.0 + decay * (derivatives.by_offset - 1.0),
        thrust + decay * (derivatives.by_offset_by_thrust - thrust),
    )

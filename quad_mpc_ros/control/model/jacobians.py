# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Jacobians of the rollout, in compiled loops.

x_{i+1} = f(x_i, u_i) over a stage of substeps; A_i = df/dx and B_i = df/du through ⊞, that is in
the tangent spaces at x_i and x_{i+1}, with the right Jacobian of SO(3). The Jacobians belong to
the discretisation in :mod:`quad_mpc_ros.control.model.rollout`, not to the differential equations.
They are exact but for anisotropic drag, rotor drag and lift: of these the rollout has the forces,
the Jacobians the mean drag alone.

Tangent order of the horizon: position, velocity, attitude, body rate, throttle, angular
acceleration.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import Actuators, actuators_in
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.rollout import (
    Discretisation,
    Midpoint,
    StateRecord,
    body_in,
    discretised,
    store_body,
    substep,
)
from quad_mpc_ros.control.model.state import TANGENT_SIZE, THETA, U_RATE, U_THROTTLE, P, V

# Offsets of the actuators in the tangent of the horizon, behind the state.
OMEGA, S, ALPHA = TANGENT_SIZE, TANGENT_SIZE + 3, TANGENT_SIZE + 4
RATE, THROTTLE, STATE_SIZE = slice(OMEGA, S), S, ALPHA + 3
ACCELERATION = slice(ALPHA, STATE_SIZE)
WITHOUT_ACTUATORS, WITHOUT_ACCELERATION = OMEGA, ALPHA
"""Sizes of the state without actuator lags, and without a lag of the torque."""

# Columns of the sensitivities to attitude, rates, angular accelerations and commanded rates.
_FROM_RATE, _FROM_ACCELERATION, _FROM_COMMAND, _COLUMNS = 3, 6, 9, 12
# Blocks of the sensitivities of the rates themselves.
_BY_RATE, _BY_ACCELERATION, _BY_COMMAND = 0, 1, 2


class _Sensitivities(NamedTuple):
    """Sensitivities of attitude, velocity and position, (12, 3) each, and of the rate loops.

    ``rates`` and ``accelerations`` (3, 3) are sensitivities of each axis to its rate, acceleration
    and command at the start of the stage, ``means`` (3, 3) of mean rates in a substep.
    """

    R: Array
    v: Array
    p: Array
    rates: Array
    accelerations: Array
    means: Array


@compiled
def jacobians(
    model: ModelParameters,
    step: float,
    inputs: Array,
    free: Array,
    start: StateRecord,
    states: RecordArray[StateRecord],
    A: Array,
    B: Array,
) -> None:
    """Roll out like :func:`roll_out` and write A (N, nx, nx) and B (N, nx, 4).

    ``nx`` is 16, 13 without a lag of the torque, or 9 without actuator lags. The input of a stage
    changes the commands of all its substeps whose ``free`` (N, M, 4) is 1; it is 0 for commands at
    a bound.
    """
    steps, substeps = inputs.shape[:2]
    columns = _FROM_ACCELERATION if A.shape[1] > WITHOUT_ACTUATORS else _FROM_RATE
    if A.shape[1] > WITHOUT_ACCELERATION:
        columns = _FROM_COMMAND
    d = discretised(model, step / substeps)
    x = body_in(start)
    store_body(x, states[0])
    sensitivities = _Sensitivities(
        np.empty((_COLUMNS, 3)),
        np.empty((_COLUMNS, 3)),
        np.empty((_COLUMNS, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
    )
    for i in range(steps):
        _begin(sensitivities)
        kept, gained = 1.0, 0.0
        by_throttle = by_command = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        own_v, own_p = 1.0, 0.0
        for j in range(substeps):
            command, let = actuators_in(inputs[i, j]), actuators_in(free[i, j])
            x, midpoint = substep(model, d, command, x)
            decay, share = midpoint.lag
            _propagate_rates(midpoint, let, sensitivities)
            _propagate(d, midpoint, columns, sensitivities)
            slope = model.thrust_scale * (2.0 * model.a * midpoint.throttle + model.b)
            thrust_slope_W = kernels.scaled(slope, kernels.column(midpoint.R, 2))
            mean_kept = share * kept
            mean_gained = let[U_THROTTLE] + share * (gained - let[U_THROTTLE])
            by_throttle = _later(d, kernels.scaled(mean_kept, thrust_slope_W), by_throttle)
            by_command = _later(d, kernels.scaled(mean_gained, thrust_slope_W), by_command)
            kept *= decay
            gained = let[U_THROTTLE] + decay * (gained - let[U_THROTTLE])
            own_p += d.phi1 * own_v
            own_v *= d.velocity_decay
        store_body(x, states[i + 1])
        _fill(A[i], B[i], own_p, own_v, sensitivities, by_command)
        if columns > _FROM_RATE:
            _fill_actuators(A[i], B[i], kept, gained, sensitivities, by_throttle)
        if columns > _FROM_ACCELERATION:
            _fill_accelerations(A[i], B[i], sensitivities)


@compiled
def _begin(sensitivities: _Sensitivities) -> None:
    """Write the sensitivities at the start of a stage."""
    dR, dv, dp, rates, accelerations, _means = sensitivities
    rates[:], accelerations[:] = 0.0, 0.0
    rates[:, _BY_RATE], accelerations[:, _BY_ACCELERATION] = 1.0, 1.0
    for n in range(_COLUMNS):
        for k in range(3):
            dR[n, k] = 1.0 if n == k else 0.0
            dv[n, k] = dp[n, k] = 0.0


@compiled
def _later(
    d: Discretisation, acceleration: kernels.Vector, moved: tuple[kernels.Vector, kernels.Vector]
) -> tuple[kernels.Vector, kernels.Vector]:
    """Return the sensitivities of velocity and position after a substep."""
    v, p = moved
    return (
        kernels.plus(kernels.scaled(d.velocity_decay, v), kernels.scaled(d.phi1, acceleration)),
        kernels.plus(
            p, kernels.plus(kernels.scaled(d.phi1, v), kernels.scaled(d.phi2, acceleration))
        ),
    )


@compiled
def _propagate_rates(midpoint: Midpoint, let: Actuators, sensitivities: _Sensitivities) -> None:
    """Propagate the sensitivities of the rate loops over a substep; ``let`` masks commands."""
    rates, accelerations, means = sensitivities[3:]
    for axis in range(3):
        step = midpoint.axes[axis]
        loop = step.response
        for by in range(3):
            command = let[U_RATE + axis] * step.follows if by == _BY_COMMAND else 0.0
            off, acceleration = rates[axis, by] - command, accelerations[axis, by]
            means[axis, by] = command + loop.mean * off + loop.mean_by_acceleration * acceleration
            rates[axis, by] = command + loop.rate * off + loop.rate_by_acceleration * acceleration
            accelerations[axis, by] = (
                loop.acceleration * off + loop.acceleration_by_acceleration * acceleration
            )


@compiled
def _propagate(
    d: Discretisation, midpoint: Midpoint, columns: int, sensitivities: _Sensitivities
) -> None:
    """Propagate the sensitivities to attitude, rates and velocity over a substep.

    Only the first ``columns`` of the state are needed; the other columns are zero.
    """
    dR, dv, dp, _rates, _accelerations, means = sensitivities
    J = kernels.right_jacobian(midpoint.half_turn)
    x_axis, y_axis = kernels.column(midpoint.R, 0), kernels.column(midpoint.R, 1)
    for n in range(_COLUMNS):
        if columns <= n < _FROM_COMMAND:
            continue
        # By how much half of the turn moves.
        half = (0.0, 0.0, 0.0)
        if n >= _FROM_RATE:
            by, k = n // 3 - 1, n % 3
            half = kernels.scaled(0.5 * d.dt * means[k, by], kernels.column(J, k))
        turned = kernels.plus(kernels.apply_transposed(midpoint.half, kernels.vector(dR[n])), half)
        # The thrust's direction moves by R (phi x e3).
        acceleration = kernels.scaled(
            midpoint.specific_thrust,
            kernels.plus(kernels.scaled(turned[1], x_axis), kernels.scaled(-turned[0], y_axis)),
        )
        v, p = _later(d, acceleration, (kernels.vector(dv[n]), kernels.vector(dp[n])))
        kernels.store_vector(v, dv[n])
        kernels.store_vector(p, dp[n])
        kernels.store_vector(
            kernels.plus(kernels.apply_transposed(midpoint.half, turned), half), dR[n]
        )


@compiled
def _fill(
    A: Array,
    B: Array,
    own_p: float,
    own_v: float,
    sensitivities: _Sensitivities,
    by_command: tuple[kernels.Vector, kernels.Vector],
) -> None:
    """Write the non-zero entries of position, velocity and attitude."""
    _fill_columns(A, THETA, 0, sensitivities)
    _fill_columns(B, U_RATE, _FROM_COMMAND, sensitivities)
    for k in range(3):
        A[P + k, P + k] = 1.0
        A[P + k, V + k] = own_p
        A[V + k, V + k] = own_v
        B[V + k, U_THROTTLE], B[P + k, U_THROTTLE] = by_command[0][k], by_command[1][k]


@compiled
def _fill_columns(matrix: Array, column: int, first: int, sensitivities: _Sensitivities) -> None:
    """Write three columns of position, velocity and attitude, from the sensitivities ``first``."""
    dR, dv, dp, _rates, _accelerations, _means = sensitivities
    for k in range(3):
        for n in range(3):
            matrix[P + k, column + n] = dp[first + n, k]
            matrix[V + k, column + n] = dv[first + n, k]
            matrix[THETA + k, column + n] = dR[first + n, k]


@compiled
def _fill_actuators(
    A: Array,
    B: Array,
    kept: float,
    gained: float,
    sensitivities: _Sensitivities,
    by_throttle: tuple[kernels.Vector, kernels.Vector],
) -> None:
    """Write the columns and rows of body rate and throttle."""
    _fill_columns(A, OMEGA, _FROM_RATE, sensitivities)
    for k in range(3):
        A[V + k, S], A[P + k, S] = by_throttle[0][k], by_throttle[1][k]
        A[OMEGA + k, OMEGA + k] = sensitivities.rates[k, _BY_RATE]
        B[OMEGA + k, U_RATE + k] = sensitivities.rates[k, _BY_COMMAND]
    A[S, S], B[S, U_THROTTLE] = kept, gained


@compiled
def _fill_accelerations(A: Array, B: Array, sensitivities: _Sensitivities) -> None:
    """Write the columns and rows of the angular acceleration."""
    _fill_columns(A, ALPHA, _FROM_ACCELERATION, sensitivities)
    accelerations = sensitivities.accelerations
    for k in range(3):
        A[OMEGA + k, ALPHA + k] = sensitivities.rates[k, _BY_ACCELERATION]
        A[ALPHA + k, OMEGA + k] = accelerations[k, _BY_RATE]
        A[ALPHA + k, ALPHA + k] = accelerations[k, _BY_ACCELERATION]
        B[ALPHA + k, U_RATE + k] = accelerations[k, _BY_COMMAND]

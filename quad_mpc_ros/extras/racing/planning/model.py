# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The equations of motion of a plan, in CasADi: one step and its bounds.

The states are position, velocity, quaternion q_WB (w, x, y, z), body rates and specific thrust.
The inputs are commanded body rates and specific thrust, with first-order lags as in the MPC's
model. If the rotors are known, each rotor's thrust is bounded, too.

Inputs are held over a step. Lags are exact, the rest uses Runge-Kutta steps of order 4.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.racing.planning.casadi_module import casadi
from quad_mpc_ros.extras.racing.planning.limits import PlannedVehicle, RotorLimits
from quad_mpc_ros.extras.racing.planning.transcription import Dynamics

P, V, Q, W, F = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), slice(13, 14)
"""Slices of position, velocity, quaternion, body rates and specific thrust in a state."""
THRUST = slice(3, 4)
"""Slice of the specific thrust in the inputs."""

_MIN_LAG = 0.002  # s
_SUBSTEPS = 2  # Runge-Kutta steps in one
_INPUT_CHANGE_COST = 2e-4  # s: cost of a change of an input by its natural size
_ROOT_OFFSET = 1e-6  # below the root
_SAMPLED_SHARES = (0.0, 0.2, 0.5, 1.0)  # of a step, at which the rotors' thrusts are bounded


def model_of(
    vehicle: PlannedVehicle, *, start: Array, start_yaw: float, lowest: float
) -> Dynamics:
    """Return the equations of motion of a vehicle, from a level rest to a level rest.

    The vehicle starts at ``start`` (3,) [m] with heading ``start_yaw`` [rad], and stays above
    ``lowest`` [m].
    """
    ca = casadi()
    x, u, h = ca.SX.sym("x", 14), ca.SX.sym("u", 4), ca.SX.sym("h")
    lags = np.maximum([*vehicle.rate_time_constant, vehicle.thrust_time_constant], _MIN_LAG)
    lagging, wanted = x[10:14], u

    def after(time: Any) -> Any:
        return wanted + (lagging - wanted) * ca.exp(-time / lags)

    body = x[0:10]
    for number in range(_SUBSTEPS):
        begin, length = h * (number / _SUBSTEPS), h / _SUBSTEPS
        body = _runge_kutta(
            lambda y, time, begin=begin: _motion(y, after(begin + time), vehicle), body, length
        )
    end = ca.vertcat(body[0:6], body[6:10] / ca.norm_2(body[6:10]), after(h))
    path, bounds = ca.SX(0, 1), (np.zeros(0), np.zeros(0))
    if vehicle.rotors is not None:
        within = [
            _rotor_thrusts(after(share * h), wanted, lags, vehicle, vehicle.rotors)
            for share in _SAMPLED_SHARES
        ]
        path = ca.vertcat(*within)
        count = path.shape[0]
        bounds = np.full(count, vehicle.rotors.least), np.full(count, vehicle.rotors.greatest)
    least, greatest = vehicle.least, vehicle.greatest
    upper = np.append(vehicle.omega_max, greatest)
    lower = np.append(-vehicle.omega_max, least)
    low, high = np.append(_free_body(-1.0), lower), np.append(_free_body(1.0), upper)
    low[P][2] = lowest
    first, last = np.full((2, len(low)), np.nan)
    first[P], first[Q] = start, (np.cos(0.5 * start_yaw), 0.0, 0.0, np.sin(0.5 * start_yaw))
    last[Q][1:3] = 0.0
    for rest in (first, last):
        rest[V], rest[W], rest[F] = 0.0, 0.0, vehicle.gravity
    return Dynamics(
        step=ca.Function("step", [x, u, h], [end]),
        acceleration=ca.Function("a", [x, u], [_motion(x[0:10], x[10:14], vehicle)[3:6]]),
        path=ca.Function("path", [x, u, h], [path]),
        path_bounds=bounds,
        input_bounds=(lower, upper),
        state_bounds=(low, high),
        first=first,
        last=last,
        scale=np.append(vehicle.omega_max, greatest),
        smoothing=_INPUT_CHANGE_COST,
    )


def rotation(q: Any) -> Any:
    """Return the rotation matrix of a quaternion w, x, y, z of length 1."""
    ca = casadi()
    w, x, y, z = q[0], q[1], q[2], q[3]
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        ca.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        ca.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _motion(y: Any, turning: Any, vehicle: PlannedVehicle) -> Any:
    """Return the derivatives of position, velocity and quaternion."""
    ca = casadi()
    v, q, w, thrust = y[V], y[Q], turning[0:3], turning[3]
    R, along = rotation(q), thrust
    pull = R[:, 2] * along - ca.vertcat(0, 0, vehicle.gravity)
    drag = vehicle.drag
    if drag.any() or vehicle.rotor_drag.any() or vehicle.translational_lift:
        u = R.T @ v
        speed = ca.sqrt(ca.fmax(thrust, _ROOT_OFFSET) / vehicle.gravity)
        force = -(ca.DM(drag) + speed * ca.DM(vehicle.rotor_drag)) * u
        lift = vehicle.translational_lift * (u[0] ** 2 + u[1] ** 2)
        pull = pull + R @ (force + ca.vertcat(0, 0, lift))
    turn = 0.5 * ca.vertcat(-ca.dot(q[1:4], w), q[0] * w + ca.cross(q[1:4], w))
    return ca.vertcat(v, pull, turn)


def _rotor_thrusts(
    lagging: Any, wanted: Any, lags: Array, vehicle: PlannedVehicle, rotors: RotorLimits
) -> Any:
    """Return the rotors' thrusts required for body rates and specific thrust."""
    ca = casadi()
    inertia, w = ca.DM(rotors.inertia), lagging[0:3]
    turn = ((wanted - lagging) / lags)[0:3]
    torque = inertia @ turn + ca.cross(w, inertia @ w)
    share = ca.DM(np.linalg.pinv(rotors.allocation))
    return share @ ca.vertcat(vehicle.mass * lagging[THRUST], torque)


def _runge_kutta(rate: Any, y: Any, h: Any) -> Any:
    k1 = rate(y, 0.0)
    k2 = rate(y + h / 2 * k1, h / 2)
    k3 = rate(y + h / 2 * k2, h / 2)
    k4 = rate(y + h * k3, h)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _free_body(sign: float) -> Array:
    """Return the bounds of position, velocity and quaternion."""
    return sign * np.concatenate((np.full(6, np.inf), np.full(4, 1.1)))

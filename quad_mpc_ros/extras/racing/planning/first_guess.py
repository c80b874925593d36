# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Initial guess of the optimiser: a point mass on the course, with attitudes from its thrust.

The motion of a point mass is found within a second and is near the plan of the vehicle. The thrust
is smoothed over the time in which a vehicle turns. The body follows the thrust with the shortest
rotations, without rotation about the thrust.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.extras.racing.planning.casadi_module import casadi
from quad_mpc_ros.extras.racing.planning.legs import CourseLeg
from quad_mpc_ros.extras.racing.planning.limits import PlannedVehicle
from quad_mpc_ros.extras.racing.planning.transcription import (
    MIN_LEG_DURATION,
    Dynamics,
    Nodes,
    solve,
)
from quad_mpc_ros.references.course import Course

_STEPS_PER_LEG = 12  # a leg
_THRUST_SHARE = 0.85  # of the thrust that a turning vehicle can use
_CRUISE_SHARE = 0.6  # of the speed reached over a leg at full thrust, of the very first guess
_SMOOTHING_TIME = 0.06  # s
_FINE_STEP = 0.004  # s
MIN_STEPS = 6  # a leg
_MAX_ITERATIONS = 400
_UP = np.array([0.0, 0.0, 1.0])


def flown_by_a_point(
    course: Course,
    legs: Sequence[CourseLeg],
    vehicle: PlannedVehicle,
    *,
    lowest: float,
) -> Nodes:
    """Return the time-optimal motion of a point mass: states p, v; inputs a.

    If the optimiser fails, straight lines at a safe speed are returned.
    """
    ca = casadi()
    x, u, h = ca.SX.sym("x", 6), ca.SX.sym("u", 3), ca.SX.sym("h")
    drag = float(np.mean(vehicle.drag + vehicle.rotor_drag))
    pull = u - drag * x[3:6]
    after = ca.vertcat(x[0:3] + h * x[3:6] + h**2 / 2 * pull, x[3:6] + h * pull)
    force = u + ca.DM(vehicle.gravity * _UP)
    most = max(_THRUST_SHARE * vehicle.greatest, 1.05 * vehicle.gravity)
    free = np.full(6, np.inf)
    low = -free
    low[2] = lowest
    dynamics = Dynamics(
        step=ca.Function("step", [x, u, h], [after]),
        acceleration=ca.Function("a", [x, u], [pull]),
        path=ca.Function("path", [x, u, h], [ca.sumsqr(force) / most**2]),
        state_bounds=(low, free),
        input_bounds=(np.full(3, -2.0 * most), np.full(3, 2.0 * most)),
        path_bounds=(np.zeros(1), np.ones(1)),
        first=np.concatenate((course.start, np.zeros(3))),
        last=np.array([np.nan] * 3 + [0.0] * 3),
        scale=np.full(3, most),
        smoothing=1e-3,
    )
    guess = _straight(course.start, legs, acceleration=most - vehicle.gravity)
    solved = solve(legs, dynamics, guess, name="point", most_iterations=_MAX_ITERATIONS)
    return solved.nodes if solved.optimal else guess


def _straight(start: Array, legs: Sequence[CourseLeg], *, acceleration: float) -> Nodes:
    places = np.array([start, *(leg.p_WB for leg in legs)])
    ways = np.diff(places, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    speeds = np.maximum(_CRUISE_SHARE * np.sqrt(2.0 * acceleration * lengths), 1.0)
    durations = np.maximum(lengths / speeds, 2.0 * MIN_LEG_DURATION)
    shares = np.arange(_STEPS_PER_LEG) / _STEPS_PER_LEG
    p = (places[:-1, None] + shares[:, None] * ways[:, None]).reshape(-1, 3)
    v = np.repeat(ways / durations[:, None], _STEPS_PER_LEG, axis=0)
    p, v = np.vstack((p, places[-1:])), np.vstack((v, np.zeros((1, 3))))
    return Nodes(
        states=np.column_stack((p, v)),
        inputs=np.zeros((len(p) - 1, 3)),
        durations=durations,
        counts=(_STEPS_PER_LEG,) * len(legs),
    )


def with_attitudes(
    point: Nodes, vehicle: PlannedVehicle, *, yaw: float, longest_step: float
) -> Nodes:
    """Return the motion of a point mass with attitudes, at steps of ``longest_step`` [s].

    :mod:`.model` defines states and inputs.
    """
    counts = np.maximum(MIN_STEPS, np.ceil(point.durations / longest_step)).astype(int)
    steps = np.repeat(point.durations / counts, counts)
    times = np.append(0.0, np.cumsum(steps))
    p, v = (_sampled(times, point.times, point.states[:, part]) for part in _POSITION_VELOCITY)
    force = _smoothed_force(point, times, vehicle)
    thrust = np.linalg.norm(force, axis=1)
    z = force / np.maximum(thrust, 1e-3)[:, None]
    R_WB = [so3.shortest_rotation(_UP[None], z[:1])[0] @ so3.exp(yaw * _UP)]
    for turn in so3.shortest_rotation(z[:-1], z[1:]):
        R_WB.append(turn @ R_WB[-1])
    R = np.array(R_WB)
    w = so3.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]) / steps[:, None]
    q = so3.quaternion_xyzw_from_rotation(R)[:, [3, 0, 1, 2]]
    flips = np.sign(np.sum(q[:-1] * q[1:], axis=1))
    q[1:] *= np.cumprod(np.where(flips == 0.0, 1.0, flips))[:, None]
    q *= np.where(q[0, 0] < 0.0, -1.0, 1.0)
    w = np.clip(np.vstack((w, np.zeros((1, 3)))), -vehicle.omega_max, vehicle.omega_max)
    inputs = np.column_stack((w, np.clip(thrust, 1.02 * vehicle.least, 0.98 * vehicle.greatest)))
    return Nodes(
        states=np.column_stack((p, v, q, inputs)),
        inputs=inputs[:-1],
        durations=point.durations,
        counts=tuple(counts.tolist()),
    )


_POSITION_VELOCITY = (slice(0, 3), slice(3, 6))


def _sampled(times: Array, knots: Array, values: Array) -> Array:
    return np.column_stack([np.interp(times, knots, column) for column in values.T])


def _smoothed_force(point: Nodes, times: Array, vehicle: PlannedVehicle) -> Array:
    """Return the running mean of the specific force (n, 3) at times; hover at both ends."""
    count = max(int(point.times[-1] / _FINE_STEP), 2)
    fine = np.linspace(0.0, point.times[-1], count)
    held = np.clip(np.searchsorted(point.times, fine, side="right") - 1, 0, len(point.inputs) - 1)
    force = point.inputs[held] + vehicle.gravity * _UP
    half = max(round(_SMOOTHING_TIME / _FINE_STEP), 1)
    padded = np.vstack((np.tile(vehicle.gravity * _UP, (half, 1)), force))
    padded = np.vstack((padded, np.tile(vehicle.gravity * _UP, (half, 1))))
    sums = np.vstack((np.zeros((1, 3)), np.cumsum(padded, axis=0)))
    smooth = (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)
    return _sampled(times, fine, smooth)

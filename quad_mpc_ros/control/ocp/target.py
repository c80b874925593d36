"""What the horizon is to track: the reference along it, and the inputs that would hold it.

The reference gives positions, attitudes and their derivatives. The inputs that hold it are the
vehicle's: the throttle carries the specific force a + R D R' v + g e3, less the lift of the air
and the disturbance, for which the attitude tilts; throttle and rates lead by what the actuators
lag. They vary within a stage as the reference does, so that a vehicle on a reference it can fly
needs no correction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import lead
from quad_mpc_ros.control.model.parameters import (
    ModelParameters,
    parameters_in,
    root_of_thrust,
    throttle_for,
)
from quad_mpc_ros.control.model.reference_window import POINT_SIZE, point_parts, sample_into
from quad_mpc_ros.control.model.rollout import SUBSTEPS, is_uneven, uneven_air
from quad_mpc_ros.control.model.state import INPUT_SIZE

# rad, in a substep: where a tilt begins or ends it does not turn.
_TILT_JUMP = 0.05

_STAGE_SIZE = 15 + (SUBSTEPS + 1) * INPUT_SIZE


class Target(NamedTuple):
    """The reference of N stages of M substeps: the parts of one buffer, see :func:`target_in`.

    ``p_WB``, ``v_WB_W`` (N, 3) and ``R_WB`` (N, 3, 3) at the ends of the stages, ``inputs``
    (N, M, 4) held over the substeps and ``mean_inputs`` (N, 4) their means over the stages;
    ``R_WB_start`` (3, 3) is the attitude at the start of the first.
    """

    p_WB: Array
    v_WB_W: Array
    R_WB: Array
    inputs: Array
    mean_inputs: Array
    R_WB_start: Array


@compiled
def target_in(buffer: Array) -> Target:
    """Return the parts of a buffer, in which they are one after another."""
    n = len(buffer) // _STAGE_SIZE
    return Target(
        buffer[: 3 * n].reshape((n, 3)),
        buffer[3 * n : 6 * n].reshape((n, 3)),
        buffer[6 * n : 15 * n].reshape((n, 3, 3)),
        buffer[15 * n : (15 + SUBSTEPS * INPUT_SIZE) * n].reshape((n, SUBSTEPS, INPUT_SIZE)),
        buffer[(15 + SUBSTEPS * INPUT_SIZE) * n : -9].reshape((n, INPUT_SIZE)),
        buffer[-9:].reshape((3, 3)),
    )


@compiled
def target_size(steps: int) -> int:
    """Return how many numbers a target of N stages has."""
    return steps * _STAGE_SIZE + 9


@compiled
def sample_target(
    elapsed_ns: int,
    offsets_ns: NDArray[np.int64],
    samples: Array,
    parameters: Array,
    step: float,
    u_min: Array,
    u_max: Array,
    buffer: Array,
) -> None:
    """Write the target of stages of ``step`` seconds from ``elapsed_ns`` after a window's stamp.

    ``samples`` and ``offsets_ns`` are the window's (:func:`.reference_window.sample_into`),
    ``parameters`` (29,) those of the vehicle, ``u_min`` and ``u_max`` (4,) its bounds.
    """
    model, target, dt = parameters_in(parameters), target_in(buffer), step / SUBSTEPS
    count = target.inputs.shape[0] * SUBSTEPS + 1
    times_ns, points = np.empty(count, np.int64), np.empty((count, POINT_SIZE))
    for k in range(count):
        times_ns[k] = elapsed_ns + np.int64(np.rint(dt * 1e9 * k))
    sample_into(times_ns, offsets_ns, samples, points)
    p, R, v, dv, w = point_parts(points)
    held, tilts = np.empty((count, INPUT_SIZE)), np.empty((count, 3))
    R_held, throttle, tilt = kernels.matrix_in_row(R[0]), 0.0, (0.0, 0.0, 0.0)
    for k in range(count):
        if k == 0 or not _is_same(points, k):
            R_held, throttle, tilt = _hold(
                model,
                kernels.matrix_in_row(R[k]),
                kernels.vector(v[k]),
                kernels.vector(dv[k]),
            )
        if k == 0:
            kernels.store_matrix(R_held, target.R_WB_start)
        held[k, 0] = throttle
        kernels.store_vector(tilt, tilts[k])
        for n in range(3):
            held[k, 1 + n] = w[k, n]
        if k > 0:
            _turn_with(tilts, R_held, dt, held, k)
        if k > 0 and k % SUBSTEPS == 0:
            i = k // SUBSTEPS - 1
            kernels.store_vector(kernels.vector(p[k]), target.p_WB[i])
            kernels.store_vector(kernels.vector(v[k]), target.v_WB_W[i])
            kernels.store_matrix(R_held, target.R_WB[i])
    _lead(model, dt, held, target, u_min=u_min, u_max=u_max)


@compiled
def _is_same(points: Array, k: int) -> bool:
    """Whether the reference moves as it did one substep before, as it does at rest."""
    same = True
    for n in range(3, 18):  # attitude, velocity, acceleration
        same &= points[k, n] == points[k - 1, n]
    return same


@compiled
def _lead(
    model: ModelParameters, dt: float, held: Array, target: Target, u_min: Array, u_max: Array
) -> None:
    """Write the commands that make actuators follow inputs (N M + 1, 4), and their means."""
    roll, pitch, yaw = model.rate_time_constants
    lags = model.thrust_time_constant, roll, pitch, yaw
    for n in range(INPUT_SIZE):
        for i in range(len(target.inputs)):
            total = 0.0
            for j in range(SUBSTEPS):
                k = i * SUBSTEPS + j
                command = lead(lags[n], dt, held[k, n], held[k + 1, n])
                target.inputs[i, j, n] = kernels.clamp(command, u_min[n], u_max[n])
                total += target.inputs[i, j, n]
            target.mean_inputs[i, n] = total / SUBSTEPS


@compiled
def _hold(
    model: ModelParameters,
    R_WB: kernels.Matrix,
    v_WB_W: kernels.Vector,
    a_WB_W: kernels.Vector,
) -> tuple[kernels.Matrix, float, kernels.Vector]:
    """Return attitude and throttle for a reference, tilted against what it does not know of.

    That is the disturbance, and drag that was learned in flight. Third is the tilt in the world.
    """
    d_W = model.a_W
    x, y, z = kernels.plus(a_WB_W, kernels.scaled(model.drag, v_WB_W))
    force = x, y, z + model.gravity
    if is_uneven(model):
        force = kernels.plus(force, kernels.scaled(-1.0, _air(model, R_WB, v_WB_W, force)))
    against = kernels.plus(force, kernels.scaled(-1.0, d_W))
    learned, tilt = model.learned_drag, (0.0, 0.0, 0.0)
    if learned != (0.0, 0.0, 0.0):
        u = kernels.apply_transposed(R_WB, v_WB_W)
        drag = kernels.apply(R_WB, (learned[0] * u[0], learned[1] * u[1], learned[2] * u[2]))
        force = force[0] - drag[0], force[1] - drag[1], force[2] - drag[2]
    if d_W != (0.0, 0.0, 0.0) or learned != (0.0, 0.0, 0.0):
        Q = _tilt(force, against)
        R_WB, tilt = kernels.multiply(Q, R_WB), kernels.log(Q)
    return R_WB, throttle_for(model, kernels.dot(kernels.column(R_WB, 2), against)), tilt


@compiled
def _air(
    model: ModelParameters, R_WB: kernels.Matrix, v_WB_W: kernels.Vector, force: kernels.Vector
) -> kernels.Vector:
    """Return what uneven air does, in the world, where the thrust has to make up for it.

    ``force`` is what the thrust has to make without it; how fast the rotors turn depends on both.
    """
    u, speed = kernels.apply_transposed(R_WB, v_WB_W), 0.0
    if model.rotor_drag != (0.0, 0.0, 0.0):
        along = kernels.dot(kernels.column(R_WB, 2), force)
        still = along - uneven_air(model, u, 0.0)[2]
        if still > 0.0:
            root = math.sqrt(model.gravity)
            speed = root_of_thrust(still, 0.5 * model.rotor_drag[2] * u[2] / root) / root
    return kernels.apply(R_WB, uneven_air(model, u, speed))


@compiled
def _tilt(before: kernels.Vector, after: kernels.Vector) -> kernels.Matrix:
    """Return the shortest rotation between two directions."""
    none = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    lengths = math.sqrt(kernels.dot(before, before) * kernels.dot(after, after))
    if lengths < 1e-6:
        return none  # no direction
    if kernels.dot(before, after) / lengths < -0.9:
        return none  # none that is shortest
    return kernels.shortest_rotation(before, after)


@compiled
def _turn_with(tilts: Array, R_WB: kernels.Matrix, dt: float, held: Array, k: int) -> None:
    """Add to the rates of a substep, and of the first, by how much the tilt turns the body."""
    change = kernels.plus(
        kernels.vector(tilts[k]), kernels.scaled(-1.0, kernels.vector(tilts[k - 1]))
    )
    if kernels.dot(change, change) > _TILT_JUMP**2:
        return
    turn = kernels.apply_transposed(R_WB, kernels.scaled(1.0 / dt, change))
    for n in range(3):
        held[k, 1 + n] += turn[n]
        if k == 1:
            held[0, 1 + n] += turn[n]

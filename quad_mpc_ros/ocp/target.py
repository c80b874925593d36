"""What the horizon is to track: the reference along it, and the inputs that would hold it.

The reference gives positions, attitudes and their derivatives. The inputs that hold it are the
vehicle's: the throttle carries the specific force a + mu v + g e3, less the disturbance, for which
the attitude tilts; throttle and rates lead by what the actuators lag. They vary within a stage as
the reference does, so that a vehicle on a reference it can fly needs no correction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.reference_window import sample_into
from quad_mpc_ros.model.rollout import INPUT_SIZE, Disturbance, Model, inverse_throttle_curve
from quad_mpc_ros.model.samples import ReferenceWindow


class Target(NamedTuple):
    """The reference of N stages of M substeps.

    ``p_WB``, ``v_WB_W`` (N, 3) and ``R_WB`` (N, 3, 3) at the ends of the stages, ``inputs``
    (N, M, 4) held over the substeps and ``mean_inputs`` (N, 4) their means over the stages.
    """

    p_WB: Array
    v_WB_W: Array
    R_WB: Array
    inputs: Array
    mean_inputs: Array


def empty_target(steps: int, substeps: int) -> Target:
    """Return room for a target."""
    return Target(
        p_WB=np.zeros((steps, 3)),
        v_WB_W=np.zeros((steps, 3)),
        R_WB=np.zeros((steps, 3, 3)),
        inputs=np.zeros((steps, substeps, INPUT_SIZE)),
        mean_inputs=np.zeros((steps, INPUT_SIZE)),
    )


class TargetSampler:
    """Samples windows at the substeps of a horizon."""

    def __init__(self, *, steps: int, substeps: int, step: float) -> None:
        self._dt = step / substeps
        count = steps * substeps
        self._offsets = np.rint(self._dt * 1e9 * np.arange(count + 1)).astype(np.int64)
        self._target = empty_target(steps, substeps)

    def sample(
        self,
        window: ReferenceWindow,
        stamp_ns: int,
        *,
        model: Model,
        disturbance: Disturbance,
        u_min: Array,
        u_max: Array,
    ) -> Target:
        """Return the target of a horizon from ``stamp_ns`` on; it is overwritten by the next."""
        _sample(
            stamp_ns - window.stamp_ns,
            self._offsets,
            window.offset_ns,
            window.p_WB,
            window.q_WB_xyzw,
            window.v_WB_W,
            window.a_WB_W,
            window.w_WB_W,
            *model,
            self._dt,
            disturbance.a_W,
            disturbance.thrust_scale,
            u_min,
            u_max,
            *self._target,
        )
        return self._target


@compiled
def _sample(
    elapsed_ns: int,
    substeps_ns: NDArray[np.int64],
    offset_ns: NDArray[np.int64],
    # samples of the window
    p_WB: Array,
    q_WB_xyzw: Array,
    v_WB_W: Array,
    a_WB_W: Array,
    w_WB_W: Array,
    # the model
    a: float,
    b: float,
    c: float,
    drag: float,
    gravity: float,
    thrust_time_constant: float,
    rate_time_constant: float,
    dt: float,
    d_W: Array,
    thrust_scale: float,
    u_min: Array,
    u_max: Array,
    # the target
    p_target: Array,
    v_target: Array,
    R_target: Array,
    inputs: Array,
    mean_inputs: Array,
) -> None:
    """Write the target from a window and the times of the ends of all substeps (N M + 1)."""
    model = Model(a, b, c, drag, gravity, thrust_time_constant, rate_time_constant)
    target = Target(p_target, v_target, R_target, inputs, mean_inputs)
    count, d = len(substeps_ns), kernels.vector(d_W)
    p, R, v = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count, 3))
    dv, w = np.empty((count, 3)), np.empty((count, 3))
    sample_into(
        elapsed_ns + substeps_ns,
        offset_ns,
        p_WB,
        q_WB_xyzw,
        v_WB_W,
        a_WB_W,
        w_WB_W,
        p,
        R,
        v,
        dv,
        w,
    )
    substeps = inputs.shape[1]
    held = np.empty((count, INPUT_SIZE))
    R_held, throttle = kernels.matrix(R[0]), 0.0
    for k in range(count):
        if k == 0 or not _is_same(R, v, dv, k):
            R_held, throttle = _hold(
                model,
                kernels.matrix(R[k]),
                kernels.vector(v[k]),
                kernels.vector(dv[k]),
                d,
                thrust_scale,
            )
        held[k, 0] = throttle
        for n in range(3):
            held[k, 1 + n] = w[k, n]
        if k > 0 and k % substeps == 0:
            i = k // substeps - 1
            kernels.store_vector(kernels.vector(p[k]), target.p_WB[i])
            kernels.store_vector(kernels.vector(v[k]), target.v_WB_W[i])
            kernels.store_matrix(R_held, target.R_WB[i])
    _lead(model, dt, held, u_min, u_max, target)


@compiled
def _is_same(R: Array, v: Array, a: Array, k: int) -> bool:
    """Whether the reference moves as it did one substep before, as it does at rest."""
    for i in range(3):
        if v[k, i] != v[k - 1, i] or a[k, i] != a[k - 1, i]:
            return False
        for j in range(3):
            if R[k, i, j] != R[k - 1, i, j]:
                return False
    return True


@compiled
def _lead(
    model: Model, dt: float, held: Array, u_min: Array, u_max: Array, target: Target
) -> None:
    """Write the commands that make actuators follow inputs (N M + 1, 4), and their means."""
    steps, substeps = target.inputs.shape[:2]
    for n in range(INPUT_SIZE):
        lag = model.thrust_time_constant if n == 0 else model.rate_time_constant
        for i in range(steps):
            total = 0.0
            for j in range(substeps):
                before, after = held[i * substeps + j, n], held[i * substeps + j + 1, n]
                # The inverse of a first-order lag: c = x + tau dx/dt.
                command = 0.5 * (before + after) + lag / dt * (after - before)
                target.inputs[i, j, n] = kernels.clamp(command, u_min[n], u_max[n])
                total += target.inputs[i, j, n]
            target.mean_inputs[i, n] = total / substeps


@compiled
def _hold(
    model: Model,
    R_WB: kernels.Matrix,
    v_WB_W: kernels.Vector,
    a_WB_W: kernels.Vector,
    d_W: kernels.Vector,
    thrust_scale: float,
) -> tuple[kernels.Matrix, float]:
    """Return the attitude, tilted against a disturbance, and the throttle for a reference."""
    x, y, z = kernels.plus(a_WB_W, kernels.scaled(model.drag, v_WB_W))
    force = x, y, z + model.gravity
    against = kernels.plus(force, kernels.scaled(-1.0, d_W))
    if d_W[0] != 0.0 or d_W[1] != 0.0 or d_W[2] != 0.0:
        R_WB = _tilted(force, against, R_WB)
    thrust = kernels.dot(kernels.column(R_WB, 2), against)
    return R_WB, inverse_throttle_curve(model.a, model.b, model.c, thrust / thrust_scale)


@compiled
def _tilted(before: kernels.Vector, after: kernels.Vector, R_WB: kernels.Matrix) -> kernels.Matrix:
    """Return an attitude turned by the shortest rotation between two directions."""
    lengths = math.sqrt(kernels.dot(before, before) * kernels.dot(after, after))
    if lengths < 1e-6:
        return R_WB  # no direction
    cosine = kernels.dot(before, after) / lengths
    if cosine < -0.9:
        return R_WB  # none that is shortest
    return kernels.multiply(kernels.shortest_rotation(before, after), R_WB)

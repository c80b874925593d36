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

from quad_mpc_ros.control.prediction import INPUT_SIZE, Disturbance, Model
from quad_mpc_ros.core import compiled as so3
from quad_mpc_ros.core.compiled import compiled
from quad_mpc_ros.core.messages import Array, ReferenceWindow
from quad_mpc_ros.core.reference import reference_points, sample_into


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
        self._points = reference_points((count + 1,))
        self._held = np.zeros((count + 1, INPUT_SIZE))

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
        points = self._points
        sample_into(window, stamp_ns + self._offsets, points)
        _fill(
            model,
            self._dt,
            (points.p_WB, points.R_WB, points.v_WB_W, points.a_WB_W, points.w_WB_B),
            disturbance.a_W,
            disturbance.thrust_scale,
            u_min,
            u_max,
            self._held,
            self._target,
        )
        return self._target


_Points = tuple[Array, Array, Array, Array, Array]


@compiled
def _fill(
    model: Model,
    dt: float,
    points: _Points,
    d_W: Array,
    thrust_scale: float,
    u_min: Array,
    u_max: Array,
    held: Array,
    target: Target,
) -> None:
    """Write the target from the reference at the ends of all substeps (N M + 1)."""
    p, R, v, a, w = points
    steps, substeps = target.inputs.shape[:2]
    d = so3.vector(d_W)
    for k in range(len(p)):
        R_held, held[k, 0] = _hold(
            model, so3.matrix(R[k]), so3.vector(v[k]), so3.vector(a[k]), d, thrust_scale
        )
        for n in range(3):
            held[k, 1 + n] = w[k, n]
        if k > 0 and k % substeps == 0:
            i = k // substeps - 1
            so3.store_vector(so3.vector(p[k]), target.p_WB[i])
            so3.store_vector(so3.vector(v[k]), target.v_WB_W[i])
            so3.store_matrix(R_held, target.R_WB[i])
    for n in range(4):
        lag = model.thrust_time_constant if n == 0 else model.rate_time_constant
        for i in range(steps):
            total = 0.0
            for j in range(substeps):
                before, after = held[i * substeps + j, n], held[i * substeps + j + 1, n]
                # The inverse of a first-order lag: c = x + tau dx/dt.
                command = 0.5 * (before + after) + lag / dt * (after - before)
                target.inputs[i, j, n] = min(max(command, u_min[n]), u_max[n])
                total += target.inputs[i, j, n]
            target.mean_inputs[i, n] = total / substeps


@compiled
def _hold(
    model: Model,
    R_WB: so3.Matrix,
    v_WB_W: so3.Vector,
    a_WB_W: so3.Vector,
    d_W: so3.Vector,
    thrust_scale: float,
) -> tuple[so3.Matrix, float]:
    """Return the attitude, tilted against a disturbance, and the throttle for a reference."""
    x, y, z = so3.plus(a_WB_W, so3.scaled(model.drag, v_WB_W))
    force = x, y, z + model.gravity
    against = so3.plus(force, so3.scaled(-1.0, d_W))
    if d_W[0] != 0.0 or d_W[1] != 0.0 or d_W[2] != 0.0:
        R_WB = _tilted(force, against, R_WB)
    thrust = so3.dot(so3.column(R_WB, 2), against)
    return R_WB, throttle_for(model, thrust / thrust_scale)


@compiled
def throttle_for(model: Model, thrust: float) -> float:
    """Return the throttle in [0, 1] whose thrust over mass [m/s^2] is nearest to one wanted."""
    missing = model.c - thrust
    if missing >= 0.0:
        return 0.0
    root = math.sqrt(model.b * model.b - 4.0 * model.a * missing)
    return min(-2.0 * missing / (model.b + root), 1.0)


@compiled
def _tilted(before: so3.Vector, after: so3.Vector, R_WB: so3.Matrix) -> so3.Matrix:
    """Return an attitude turned by the shortest rotation between two directions."""
    lengths = math.sqrt(so3.dot(before, before) * so3.dot(after, after))
    if lengths < 1e-6:
        return R_WB  # no direction
    cosine = so3.dot(before, after) / lengths
    if cosine < -0.9:
        return R_WB  # none that is shortest
    x, y, z = so3.scaled(1.0 / lengths, so3.cross(before, after))
    k = 1.0 / (1.0 + cosine)
    rotation = (
        cosine + k * x * x,
        k * x * y - z,
        k * x * z + y,
        k * x * y + z,
        cosine + k * y * y,
        k * y * z - x,
        k * x * z - y,
        k * y * z + x,
        cosine + k * z * z,
    )
    return so3.multiply(rotation, R_WB)

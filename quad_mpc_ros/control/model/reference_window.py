"""Sampling a window of the reference at any time, independent of the window's own step."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.samples import ReferenceWindow


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencePoints:
    """The reference at one or more times.

    Shapes, with leading dimensions of the times: ``p_WB``, ``v_WB_W``, ``a_WB_W``, ``w_WB_B``
    (..., 3) in m, m/s, m/s^2, rad/s; ``R_WB`` (..., 3, 3).
    """

    p_WB: Array
    R_WB: Array
    v_WB_W: Array
    a_WB_W: Array
    w_WB_B: Array

    @property
    def v_WB_B(self) -> Array:
        """Velocity in the body frame of the reference (..., 3) [m/s]."""
        return np.asarray(np.einsum("...ji,...j->...i", self.R_WB, self.v_WB_W))


def sample(window: ReferenceWindow, stamps_ns: ArrayLike) -> ReferencePoints:
    """Return the reference at ``stamps_ns`` (absolute, any shape).

    Between samples: position by the cubic through position and velocity, velocity by the cubic
    through velocity and acceleration, attitude by the cubic through attitude and body rate (in the
    tangent space of the sample before); acceleration and rate are the derivatives of the last two.
    Before the first sample the first one holds; from the last one on its pose holds, at rest.
    """
    times = np.asarray(stamps_ns, dtype=np.int64)
    points = np.empty((times.size, POINT_SIZE))
    sample_into(
        times_ns=times.reshape(-1) - window.stamp_ns,
        offsets_ns=window.offset_ns,
        samples=packed(window),
        points=points,
    )
    return reference_points(points.reshape(*times.shape, POINT_SIZE))


def reference_points(points: Array) -> ReferencePoints:
    """Return points (..., 21) of :func:`sample_into` under their names."""
    parts = (points[..., start:end].copy() for start, end in itertools.pairwise(_POINT_ENDS))
    p, R, v, a, w = parts
    return ReferencePoints(p_WB=p, R_WB=R.reshape(*p.shape, 3), v_WB_W=v, a_WB_W=a, w_WB_B=w)


def packed(window: ReferenceWindow) -> Array:
    """Return the samples of a window as compiled code takes them, (n, 16).

    A row holds position, quaternion, velocity, acceleration and body rate in the world.
    """
    return np.concatenate(
        (window.p_WB, window.q_WB_xyzw, window.v_WB_W, window.a_WB_W, window.w_WB_W), axis=1
    )


POINT_SIZE = 21
_POINT_ENDS = (0, 3, 12, 15, 18, 21)


@compiled
def sample_into(
    times_ns: NDArray[np.int64], offsets_ns: NDArray[np.int64], samples: Array, points: Array
) -> None:
    """Write the points (m, 21) at times (m,) after the stamp of a window of samples (n, 16).

    A row of ``samples`` is one of :func:`packed`, a row of ``points`` holds position, rotation row
    by row, velocity, acceleration, and body rate in the body.
    """
    p, q, v, a, w = window_parts(samples)
    p_at, R_at, v_at, a_at, w_at = point_parts(points)
    last = len(offsets_ns) - 1
    lower, segment, still = 0, -1, False
    R, turn, w_before, w_after = _segment(q, w, 0, 0)
    for k in range(len(times_ns)):
        time = times_ns[k]
        # Of two samples at the same time the later one holds from that time on.
        while lower < last and offsets_ns[lower + 1] <= time:
            lower += 1
        while lower > 0 and offsets_ns[lower] > time:
            lower -= 1
        holds = lower == last or time <= offsets_ns[0]
        upper = lower if holds else lower + 1
        if lower != segment:
            R, turn, w_before, w_after = _segment(q, w, lower, upper)
            segment = lower if not holds else -1
            still = not holds and _is_still(samples, lower)
        if holds or still:
            moving = 1.0 if lower < last else 0.0
            for i in range(3):
                p_at[k, i] = p[lower, i]
                v_at[k, i] = moving * v[lower, i]
                a_at[k, i] = moving * a[lower, i]
            kernels.store_matrix_row(R, R_at[k])
            kernels.store_vector(kernels.scaled(moving, w_before), w_at[k])
            continue
        width = 1e-9 * (offsets_ns[upper] - offsets_ns[lower])
        fraction = 1e-9 * (time - offsets_ns[lower]) / width
        for i in range(3):
            p_at[k, i], _ = _cubic(
                p[lower, i], p[upper, i], v[lower, i], v[upper, i], fraction, width
            )
            v_at[k, i], a_at[k, i] = _cubic(
                v[lower, i], v[upper, i], a[lower, i], a[upper, i], fraction, width
            )
        # The attitude is R exp(x) with the cubic x from zero to the whole turn.
        x0, s0 = _cubic(0.0, turn[0], w_before[0], w_after[0], fraction, width)
        x1, s1 = _cubic(0.0, turn[1], w_before[1], w_after[1], fraction, width)
        x2, s2 = _cubic(0.0, turn[2], w_before[2], w_after[2], fraction, width)
        kernels.store_matrix_row(kernels.multiply(R, kernels.exp((x0, x1, x2))), R_at[k])
        kernels.store_vector(
            kernels.apply(kernels.right_jacobian((x0, x1, x2)), (s0, s1, s2)), w_at[k]
        )


@compiled
def window_parts(samples: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return position, quaternion, velocity, acceleration, body rate: views of a window's rows."""
    return samples[:, 0:3], samples[:, 3:7], samples[:, 7:10], samples[:, 10:13], samples[:, 13:16]


@compiled
def point_parts(points: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return position, rotation, velocity, acceleration, body rate: views of the points' rows."""
    return points[:, 0:3], points[:, 3:12], points[:, 12:15], points[:, 15:18], points[:, 18:21]


@compiled
def _is_still(samples: Array, lower: int) -> bool:
    """Whether nothing moves between a sample and the next."""
    p, q, v, a, w = window_parts(samples)
    for i in range(3):
        for k in (lower, lower + 1):
            if p[k, i] != p[lower, i] or v[k, i] != 0.0 or a[k, i] != 0.0 or w[k, i] != 0.0:
                return False
    same = True
    for i in range(4):
        same &= q[lower + 1, i] == q[lower, i]
    return same


@compiled
def _segment(
    q_xyzw: Array, w_WB_W: Array, lower: int, upper: int
) -> tuple[kernels.Matrix, kernels.Vector, kernels.Vector, kernels.Vector]:
    """Return attitude before, turn to the one after, and its slopes, in the body before."""
    R = kernels.rotation((q_xyzw[lower, 0], q_xyzw[lower, 1], q_xyzw[lower, 2], q_xyzw[lower, 3]))
    before = kernels.apply_transposed(R, kernels.vector(w_WB_W[lower]))
    held = True
    for i in range(4):
        held &= q_xyzw[lower, i] == q_xyzw[upper, i]
    if held:  # exactly
        return (
            R,
            (0.0, 0.0, 0.0),
            before,
            kernels.apply_transposed(R, kernels.vector(w_WB_W[upper])),
        )
    R_after = kernels.rotation(
        (q_xyzw[upper, 0], q_xyzw[upper, 1], q_xyzw[upper, 2], q_xyzw[upper, 3])
    )
    turn = kernels.log(kernels.multiply(kernels.transposed(R), R_after))
    after = kernels.apply_transposed(R_after, kernels.vector(w_WB_W[upper]))
    return R, turn, before, kernels.apply(kernels.right_jacobian_inverse(turn), after)


@compiled
def _cubic(
    before: float,
    after: float,
    slope_before: float,
    slope_after: float,
    fraction: float,
    width: float,
) -> tuple[float, float]:
    """Return Hermite's cubic and its slope; equal values at rest come out without rounding."""
    f, g = fraction, 1.0 - fraction
    value = before + (
        f * f * (3.0 - 2.0 * f) * (after - before)
        + width * f * g * (g * slope_before - f * slope_after)
    )
    slope = (
        6.0 * f * g * (after - before) / width
        + g * (1.0 - 3.0 * f) * slope_before
        + f * (3.0 * f - 2.0) * slope_after
    )
    return value, slope

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Sampling a window of the reference at any time, independent of the window's own step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3, Vector4
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
    tangent space of the previous sample); acceleration and rate are the derivatives of velocity
    and attitude. Outside the window the first sample or the last pose, at rest, holds.
    """
    times = np.asarray(stamps_ns, dtype=np.int64)
    points = PointRecord.zeros(times.size)
    sample_into(
        times_ns=times.reshape(-1) - window.stamp_ns, samples=packed(window), points=points
    )
    return reference_points(points.reshape(times.shape))


def reference_points(points: RecordArray[PointRecord]) -> ReferencePoints:
    """Return points of :func:`sample_into`, of any shape, as new arrays."""
    return ReferencePoints(**{name: points[name].copy() for name in PointRecord.names()})


class SampleRecord(Record):
    """A sample of a window, for compiled code."""

    offset_ns: int  # from the window's stamp
    p_WB: Vector3  # m
    q_WB_xyzw: Vector4
    v_WB_W: Vector3  # m/s
    a_WB_W: Vector3  # m/s^2
    w_WB_W: Vector3  # rad/s, in the world


class PointRecord(Record):
    """The reference at a time, with the fields of :class:`ReferencePoints`."""

    p_WB: Vector3
    R_WB: Matrix3
    v_WB_W: Vector3
    a_WB_W: Vector3
    w_WB_B: Vector3


_SAMPLE_FIELDS = SampleRecord.names()


def packed(window: ReferenceWindow) -> RecordArray[SampleRecord]:
    """Return the samples of a window (n,) for compiled code."""
    samples, arrays = SampleRecord.zeros(window.offset_ns.size), vars(window)
    for name in _SAMPLE_FIELDS:
        samples[name] = arrays[name]
    return samples


@compiled
def sample_into(
    times_ns: NDArray[np.int64],
    samples: RecordArray[SampleRecord],
    points: RecordArray[PointRecord],
) -> None:
    """Write the points (m,) at times (m,) after the stamp of a window of samples (n,)."""
    last = len(samples) - 1
    lower, segment = 0, -1
    R, turn, w_before, w_after = _segment(samples[0], samples[0])
    for k in range(len(times_ns)):
        time, point = times_ns[k], points[k]
        # From the time of two samples on, the later one holds.
        while lower < last and samples[lower + 1].offset_ns <= time:
            lower += 1
        while lower > 0 and samples[lower].offset_ns > time:
            lower -= 1
        holds = lower == last or time <= samples[0].offset_ns
        before, after = samples[lower], samples[lower if holds else lower + 1]
        if lower != segment:
            R, turn, w_before, w_after = _segment(before, after)
            segment = lower if not holds else -1
        if holds:
            moving = 1.0 if lower < last else 0.0
            for i in range(3):
                point.p_WB[i] = before.p_WB[i]
                point.v_WB_W[i] = moving * before.v_WB_W[i]
                point.a_WB_W[i] = moving * before.a_WB_W[i]
            kernels.store_matrix(R, point.R_WB)
            kernels.store_vector(kernels.scaled(moving, w_before), point.w_WB_B)
            continue
        width = 1e-9 * (after.offset_ns - before.offset_ns)
        fraction = 1e-9 * (time - before.offset_ns) / width
        for i in range(3):
            v, v_after = before.v_WB_W[i], after.v_WB_W[i]
            point.p_WB[i], _ = _cubic(before.p_WB[i], after.p_WB[i], v, v_after, fraction, width)
            point.v_WB_W[i], point.a_WB_W[i] = _cubic(
                v, v_after, before.a_WB_W[i], after.a_WB_W[i], fraction, width
            )
        # The attitude is R exp(x) with the cubic x from zero to the whole turn.
        x0, s0 = _cubic(0.0, turn[0], w_before[0], w_after[0], fraction, width)
        x1, s1 = _cubic(0.0, turn[1], w_before[1], w_after[1], fraction, width)
        x2, s2 = _cubic(0.0, turn[2], w_before[2], w_after[2], fraction, width)
        kernels.store_matrix(kernels.multiply(R, kernels.exp((x0, x1, x2))), point.R_WB)
        kernels.store_vector(
            kernels.apply(kernels.right_jacobian((x0, x1, x2)), (s0, s1, s2)), point.w_WB_B
        )


@compiled
def _is_same_attitude(before: SampleRecord, after: SampleRecord) -> bool:
    same = True
    for i in range(4):
        same &= before.q_WB_xyzw[i] == after.q_WB_xyzw[i]
    return same


@compiled
def _segment(
    before: SampleRecord, after: SampleRecord
) -> tuple[kernels.Matrix, kernels.Vector, kernels.Vector, kernels.Vector]:
    """Return the previous attitude, the rotation to the next, and slopes in the previous body."""
    R = kernels.rotation(kernels.quaternion_in(before.q_WB_xyzw))
    w_before, w_after = kernels.vector(before.w_WB_W), kernels.vector(after.w_WB_W)
    slope = kernels.apply_transposed(R, w_before)
    if _is_same_attitude(before, after):  # exactly
        return R, (0.0, 0.0, 0.0), slope, kernels.apply_transposed(R, w_after)
    R_after = kernels.rotation(kernels.quaternion_in(after.q_WB_xyzw))
    turn = kernels.log(kernels.multiply(kernels.transposed(R), R_after))
    slope_after = kernels.apply_transposed(R_after, w_after)
    return R, turn, slope, kernels.apply(kernels.right_jacobian_inverse(turn), slope_after)


@compiled
def _cubic(
    before: float,
    after: float,
    slope_before: float,
    slope_after: float,
    fraction: float,
    width: float,
) -> tuple[float, float]:
    """Return Hermite's cubic and its slope; equal values at rest are returned without rounding."""
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

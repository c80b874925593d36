"""Body rates, and velocity where it is missing too, from a sequence of poses."""

from __future__ import annotations

import dataclasses

import numpy as np

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import OdometrySample

_LONGEST_GAP_NS = 200_000_000
_FASTEST = 30.0  # m/s: beyond it the estimate stepped


class PoseDifferentiator:
    """Differences between successive poses, which lag by half the time between them."""

    def __init__(self, *, velocity_too: bool) -> None:
        self._velocity_too = velocity_too
        self._before: OdometrySample | None = None
        self._v_WB_W: Array = np.zeros(3)

    def completed(self, odometry: OdometrySample) -> OdometrySample | None:
        """Return an odometry with what it lacks, or None for the first and after a gap.

        Raises ``ValueError`` for a quaternion without a rotation.
        """
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        before, self._before = self._before, odometry
        if before is None:
            return None
        gap_ns = odometry.stamp_ns - before.stamp_ns
        if not 0 < gap_ns <= _LONGEST_GAP_NS:
            return None
        per_second = 1e9 / gap_ns
        R_before = so3.rotation_from_quaternion_xyzw(before.q_WB_xyzw)
        w_WB_B = per_second * so3.log(R_before.T @ R_WB)
        if not self._velocity_too:
            return dataclasses.replace(odometry, w_WB_B=w_WB_B)
        v_WB_W = per_second * (odometry.p_WB - before.p_WB)
        if float(np.linalg.norm(v_WB_W)) < _FASTEST:
            self._v_WB_W = v_WB_W
        return dataclasses.replace(odometry, w_WB_B=w_WB_B, v_WB_B=R_WB.T @ self._v_WB_W)

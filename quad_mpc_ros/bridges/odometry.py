"""From the states that a stack sends to odometry for the MPC: what is missing, stamps, jumps."""

from __future__ import annotations

import dataclasses

import numpy as np

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import OdometrySample
from quad_mpc_ros.model.state import state_from_odometry

_LONGEST_POSE_GAP_NS = 200_000_000
_FASTEST = 30.0  # m/s: beyond it the estimate stepped
_JUMP = 0.5  # m, beyond what the velocity explains
_LONGEST_JUMP_GAP_NS = 1_000_000_000


class PoseDifferentiator:
    """Body rates, and velocity if wanted, by differences of successive poses.

    A difference lags by half the time between two poses.
    """

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
        if not 0 < gap_ns <= _LONGEST_POSE_GAP_NS:
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


class OdometryStamps:
    """Decides the stamp of each odometry: the stack's, if it is of the node's clock.

    A stack may count from its own start, or its clock may not be synchronised yet. Then the time
    of arrival is the best there is.
    """

    def __init__(self, *, tolerance: float) -> None:
        self._tolerance_ns = round(tolerance * 1e9)
        self._newest_ns: int | None = None

    def stamp(self, stack_ns: int, *, now_ns: int) -> int | None:
        """Return the stamp of a state, or None for one that is not newer than the last.

        A clock that was set back by more than the tolerance is believed.
        """
        stamp_ns = stack_ns if abs(now_ns - stack_ns) <= self._tolerance_ns else now_ns
        if self._newest_ns is not None and 0 <= self._newest_ns - stamp_ns < self._tolerance_ns:
            return None
        self._newest_ns = stamp_ns
        return stamp_ns


class PositionJumps:
    """Counts jumps of the estimated position. The odometry is passed on as it is."""

    def __init__(self) -> None:
        self.count = 0
        self._before: OdometrySample | None = None
        self._v_WB_W: Array = np.zeros(3)

    def check(self, odometry: OdometrySample, *, cause: str | None) -> str | None:
        """Return a warning if the position jumped; ``cause`` is what the stack said of a reset."""
        before, v_before = self._before, self._v_WB_W
        self._before, self._v_WB_W = odometry, state_from_odometry(odometry).v_WB_W
        if before is None:
            return None
        gap_ns = odometry.stamp_ns - before.stamp_ns
        mean_velocity = 0.5 * (v_before + self._v_WB_W)
        jump = float(np.linalg.norm(odometry.p_WB - before.p_WB - 1e-9 * gap_ns * mean_velocity))
        if cause is None and not (0 < gap_ns < _LONGEST_JUMP_GAP_NS and jump > _JUMP):
            return None
        self.count += 1
        return f"the estimate steps by {jump:.2f} m ({cause or 'no reset was announced'})"

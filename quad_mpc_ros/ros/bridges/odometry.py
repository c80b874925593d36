"""From the states that a stack sends to odometry for the MPC: what is missing, stamps, jumps."""

from __future__ import annotations

import dataclasses

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import state_from_odometry

_LONGEST_POSE_GAP_NS = 200_000_000
_FASTEST = 30.0  # m/s: beyond it the estimate stepped
_JUMP = 0.5  # m, beyond what the velocity explains
_LONGEST_JUMP_GAP_NS = 1_000_000_000
# Of two clocks, at most: real ones keep within 1e-4, but a simulation in real time falls behind.
_DRIFT = 0.02
_LATE_NS = 1_000_000_000


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
    """Decides the stamp of each odometry, by the node's clock.

    A stack may count from its own start, its clock may not be synchronised yet, or may be set. A
    clock that agrees with the node's is taken as it is, with what it tells of the latency. Of
    another one only the fastest arrival is known to have come at once, and what comes later than
    that is stamped as late as it is: a faster arrival changes no more than how late the others
    were, and what a link held up is not stamped as if it were new.
    """

    def __init__(self, *, tolerance: float) -> None:
        self._tolerance_ns = round(tolerance * 1e9)
        self._behind_ns = 0  # of the stack's clock behind the node's
        self._age_ns = 0  # of the last state when it arrived
        self._last: tuple[int, int] | None = None  # the stack's time of it, and its arrival
        self._late_since_ns: int | None = None
        self._newest_ns: int | None = None

    def stamp(self, stack_ns: int, *, now_ns: int) -> int | None:
        """Return the stamp of a state, or None for one that is not newer than the last.

        A clock of the node that was set back by more than the tolerance is believed.
        """
        self._follow(stack_ns, now_ns)
        self._last, self._age_ns = (stack_ns, now_ns), now_ns - stack_ns - self._behind_ns
        stamp_ns = stack_ns + self._behind_ns
        newest_ns = self._newest_ns
        if newest_ns is not None and stamp_ns <= newest_ns <= now_ns + self._tolerance_ns:
            return None
        self._newest_ns = stamp_ns
        return stamp_ns

    def _follow(self, stack_ns: int, now_ns: int) -> None:
        """Find out how the two clocks differ."""
        apart_ns = now_ns - stack_ns
        if self._last is None or self._was_set(stack_ns, now_ns):
            self._differ_by(apart_ns - min(self._age_ns, self._tolerance_ns), apart_ns)
            return
        self._behind_ns += self._forgotten(now_ns)
        age_ns = apart_ns - self._behind_ns
        if age_ns < -self._tolerance_ns:
            self._differ_by(apart_ns - min(self._age_ns, self._tolerance_ns), apart_ns)
        elif age_ns < 0 and self._behind_ns != 0:
            self._behind_ns = apart_ns
        elif self._has_been_late(age_ns, now_ns):
            self._differ_by(apart_ns, apart_ns)

    def _differ_by(self, behind_ns: int, apart_ns: int) -> None:
        """Take over by how much, or not at all if that is within the tolerance."""
        self._behind_ns = 0 if abs(apart_ns) <= self._tolerance_ns else behind_ns
        self._late_since_ns = None

    def _was_set(self, stack_ns: int, now_ns: int) -> bool:
        """Whether one of the clocks runs backwards: what waits in a queue does not."""
        assert self._last is not None
        before_ns, arrived_ns = self._last
        return min(stack_ns - before_ns, now_ns - arrived_ns) < -self._tolerance_ns

    def _forgotten(self, now_ns: int) -> int:
        """Return by how much two clocks may have drifted apart since the last arrival."""
        assert self._last is not None
        if self._behind_ns == 0:
            return 0
        drift_ns = round(_DRIFT * max(now_ns - self._last[1], 0))
        return min(drift_ns, max(self._age_ns, 0))

    def _has_been_late(self, age_ns: int, now_ns: int) -> bool:
        """Whether all of a second was late, so that a clock was set rather than a link slow."""
        if age_ns <= self._tolerance_ns:
            self._late_since_ns = None
        elif self._late_since_ns is None:
            self._late_since_ns = now_ns
        return self._late_since_ns is not None and now_ns - self._late_since_ns > _LATE_NS


class PositionJumps:
    """Counts jumps of the estimated position. The odometry is passed on as it is."""

    def __init__(self) -> None:
        self.count = 0
        self.announced: EstimateReset | None = None
        """What the stack said of the newest odometry, if it is the first after a reset."""
        self._before: OdometrySample | None = None
        self._v_WB_W: Array = np.zeros(3)

    def check(self, odometry: OdometrySample, *, cause: str | None) -> str | None:
        """Return a warning if the position jumped; ``cause`` is what the stack said of a reset."""
        before, v_before = self._before, self._v_WB_W
        self.announced = None
        self._before, self._v_WB_W = odometry, state_from_odometry(odometry).v_WB_W
        if before is None:
            return None
        gap_ns = odometry.stamp_ns - before.stamp_ns
        mean_velocity = 0.5 * (v_before + self._v_WB_W)
        jump = float(np.linalg.norm(odometry.p_WB - before.p_WB - 1e-9 * gap_ns * mean_velocity))
        if cause is None and not (0 < gap_ns < _LONGEST_JUMP_GAP_NS and jump > _JUMP):
            return None
        self.count += 1
        if cause is not None:
            self.announced = EstimateReset.between(before, odometry)
        return f"the estimate steps by {jump:.2f} m ({cause or 'no reset was announced'})"

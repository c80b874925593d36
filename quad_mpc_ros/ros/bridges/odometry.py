"""The stamps of the odometry that the MPC gets."""

from __future__ import annotations

import math

from quad_mpc_ros.control.estimation.clock_offset import ClockOffset, PersistentOffset

_CLOCK_STEP_DELAY_NS = 1_000_000_000
_CLOCK_TOLERANCE_NS = 100_000_000  # between two clocks that agree


class OdometryStamps:
    """Decides the stamp of each odometry, by the node's clock.

    A stack may count from its own start, its clock may not be synchronised yet, or may be set. A
    clock that agrees with the node's is taken as it is, so that stamps show the latency. Of
    another clock the offset is estimated (:class:`.ClockOffset`), so that what a link held up is
    not stamped as if it were new.
    """

    def __init__(self) -> None:
        self._offset = ClockOffset(until_last=True)
        self._last: tuple[int, int] | None = None  # the stack's time of it, and its arrival
        self._late = PersistentOffset()
        self._newest_ns: int | None = None

    def stamp(self, stack_ns: int, *, now_ns: int) -> int | None:
        """Return the stamp of a state, or None for one that is not newer than the last.

        Should the node's clock be set back by more than the tolerance, older stamps are accepted.
        """
        offset, last_age_ns = self._offset, self._offset.last_age_ns
        agrees, age_ns = offset.behind_ns == 0, now_ns - stack_ns
        if not agrees:
            age_ns = offset.follow(stack_ns, now_ns=now_ns)
        if self._was_set(stack_ns, now_ns) or age_ns < -_CLOCK_TOLERANCE_NS:
            self._set(stack_ns, now_ns, age_ns=min(last_age_ns, _CLOCK_TOLERANCE_NS))
        elif (agrees or age_ns >= 0) and self._has_been_late(age_ns, now_ns):
            self._set(stack_ns, now_ns, age_ns=0)
        elif agrees:
            offset.set(0, stamp_ns=stack_ns, now_ns=now_ns)
        self._last = stack_ns, now_ns
        stamp_ns, newest_ns = stack_ns + offset.behind_ns, self._newest_ns
        if newest_ns is not None and stamp_ns <= newest_ns <= now_ns + _CLOCK_TOLERANCE_NS:
            return None
        self._newest_ns = stamp_ns
        return stamp_ns

    def _set(self, stack_ns: int, now_ns: int, *, age_ns: int) -> None:
        """Take over the offset by a state of an age, or none if that is within the tolerance."""
        apart_ns = now_ns - stack_ns
        behind_ns = 0 if abs(apart_ns) <= _CLOCK_TOLERANCE_NS else apart_ns - age_ns
        self._offset.set(behind_ns, stamp_ns=stack_ns, now_ns=now_ns)
        self._late.clear()

    def _was_set(self, stack_ns: int, now_ns: int) -> bool:
        """Whether one of the clocks runs backwards, or nothing came before."""
        if self._last is None:
            return True
        before_ns, arrived_ns = self._last  # what waits in a queue is not this late
        return min(stack_ns - before_ns, now_ns - arrived_ns) < -_CLOCK_TOLERANCE_NS

    def _has_been_late(self, age_ns: int, now_ns: int) -> bool:
        """Whether all of a second was late, so that a clock was set rather than a link slow."""
        if age_ns <= _CLOCK_TOLERANCE_NS:
            self._late.clear()
            return False
        late_ns = self._late.duration_ns(age_ns, now_ns=now_ns, tolerance_ns=math.inf)
        return late_ns > _CLOCK_STEP_DELAY_NS

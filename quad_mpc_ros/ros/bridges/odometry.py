# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of the published odometry."""

from __future__ import annotations

import math

from quad_mpc_ros.control.estimation.clock_offset import ClockOffset, PersistentOffset

_CLOCK_STEP_DELAY_NS = 1_000_000_000
_CLOCK_TOLERANCE_NS = 100_000_000  # between two clocks that agree


class OdometryStamps:
    """Converts the stamps of a stack's odometry to the node's clock.

    A stack's clock may count from its start, be unsynchronised, or be set. Stamps of a clock that
    agrees with the node's are unchanged, so they show the latency. The offset of other clocks is
    estimated (:class:`.ClockOffset`), so a delayed message does not look new.
    """

    def __init__(self) -> None:
        self._offset = ClockOffset(until_last=True)
        self._last: tuple[int, int] | None = None  # stack's stamp and arrival
        self._late = PersistentOffset()
        self._newest_ns: int | None = None

    def stamp(self, stack_ns: int, *, now_ns: int) -> int | None:
        """Return the stamp of a state, or None for a state that is not newer than the last.

        If the node's clock was set back by more than the tolerance, older stamps are accepted.
        """
        offset, last_age_ns = self._offset, self._offset.last_age_ns
        agrees, age_ns = offset.behind_ns == 0, now_ns - stack_ns
        if not agrees:
            age_ns = offset.follow(stack_ns, now_ns=now_ns)
        if self._was_set(stack_ns, now_ns) or age_ns < -_CLOCK_TOLERANCE_NS:
            self._set(stack_ns, now_ns, age_ns=min(max(last_age_ns, 0), _CLOCK_TOLERANCE_NS))
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
        """Set the offset from a state of an age; 0 if the age is within the tolerance."""
        apart_ns = now_ns - stack_ns
        behind_ns = 0 if abs(apart_ns) <= _CLOCK_TOLERANCE_NS else apart_ns - age_ns
        self._offset.set(behind_ns, stamp_ns=stack_ns, now_ns=now_ns)
        self._late.clear()

    def _was_set(self, stack_ns: int, now_ns: int) -> bool:
        """Return whether a clock was set back, or this is the first state."""
        if self._last is None:
            return True
        before_ns, arrived_ns = self._last  # queued messages are less late than this
        return min(stack_ns - before_ns, now_ns - arrived_ns) < -_CLOCK_TOLERANCE_NS

    def _has_been_late(self, age_ns: int, now_ns: int) -> bool:
        """Return whether states were late for a second, as after a clock was set."""
        if age_ns <= _CLOCK_TOLERANCE_NS:
            self._late.clear()
            return False
        late_ns = self._late.duration_ns(age_ns, now_ns=now_ns, tolerance_ns=math.inf)
        return late_ns > _CLOCK_STEP_DELAY_NS

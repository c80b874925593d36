"""Which odometries trigger a tick: those nearest to the times of the control rate."""

from __future__ import annotations

# So many periods away from when it is due, an odometry is of another clock.
_TIMES_AWAY = 3


class Decimation:
    """Takes of the odometries around each tick of the control rate the nearest.

    Half the distance between odometries is forgiven, so jitter costs no tick when they come at the
    control rate, and faster ones are still told apart.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._due_ns: int | None = None
        self._mean_ns = period_ns  # smoothed distance between odometries, never above the period
        self._previous_ns: int | None = None

    def is_due(self, stamp_ns: int) -> bool:
        """Take the stamp of the next odometry and return whether it triggers a tick."""
        self._measure(stamp_ns)
        if self._due_ns is None or abs(stamp_ns - self._due_ns) > _TIMES_AWAY * self._period_ns:
            self._due_ns = stamp_ns  # the first, or the first of a clock that was set
        if stamp_ns < self._due_ns - self._mean_ns // 2:
            return False
        overdue = stamp_ns > self._due_ns + self._period_ns
        self._due_ns = (stamp_ns if overdue else self._due_ns) + self._period_ns
        return True

    def _measure(self, stamp_ns: int) -> None:
        if self._previous_ns is not None and stamp_ns > self._previous_ns:
            distance_ns = min(stamp_ns - self._previous_ns, self._period_ns)
            self._mean_ns += (distance_ns - self._mean_ns) // 4
        self._previous_ns = stamp_ns

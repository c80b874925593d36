"""Stamps on the node's clock, never backwards."""

from __future__ import annotations


class OdometryStamps:
    """Decides the stamp of each odometry: the stack's, when it is of the node's clock.

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

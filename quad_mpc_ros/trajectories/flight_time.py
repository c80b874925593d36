"""The time by which a reference is flown, which stands still while nothing of it is published."""

from __future__ import annotations


class FlightTime:
    """Stamps without the pauses: what goes on does so where it stopped, and does not jump ahead.

    All times are nanoseconds of the clock of the stamps.
    """

    def __init__(self) -> None:
        self._paused_ns = 0
        self._since_ns: int | None = None

    def pause(self, now_ns: int) -> None:
        """Stand still from now on."""
        self._since_ns = now_ns

    def resume(self, now_ns: int) -> None:
        """Go on, when it stood still; a clock that was set back meanwhile pauses nothing."""
        if self._since_ns is not None:
            self._paused_ns += max(0, now_ns - self._since_ns)
            self._since_ns = None

    def at(self, stamp_ns: int) -> int:
        """Return the time of the flight at a stamp."""
        return stamp_ns - self._paused_ns

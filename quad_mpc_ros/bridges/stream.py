"""Whether setpoints have run for long enough for an autopilot to accept them."""

from __future__ import annotations

_LONGEST_GAP_NS = 500_000_000  # PX4 wants 2 Hz
_NEEDED_NS = 1_100_000_000  # for more than a second


class SetpointStream:
    """Follows the times at which the stack was spoken to."""

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._newest_ns = 0

    def sent(self, *, now_ns: int) -> None:
        """Tell that something was sent now."""
        if self._since_ns is None or self._stopped(now_ns):
            self._since_ns = now_ns
        self._newest_ns = now_ns

    def refusal(self, *, now_ns: int) -> str | None:
        """Return why the autopilot would not accept the stream yet, or None."""
        if self._since_ns is None or self._stopped(now_ns):
            return "nothing reaches the autopilot"
        if now_ns - self._since_ns < _NEEDED_NS:
            return "the setpoints have to run for a second first: ask again"
        return None

    def _stopped(self, now_ns: int) -> bool:
        return now_ns - self._newest_ns > _LONGEST_GAP_NS

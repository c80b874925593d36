"""What a bridge knows of its autopilot: the latest status, and how long setpoints have run."""

from __future__ import annotations

from typing import Any

_LONGEST_GAP_NS = 500_000_000  # PX4 wants 2 Hz
_NEEDED_NS = 1_100_000_000  # for more than a second


class LatestStatus:
    """Holds the newest status, which is valid for ``timeout`` seconds."""

    def __init__(self, *, timeout: float) -> None:
        self._timeout_ns = round(timeout * 1e9)
        self._value: Any = None
        self._received_ns = 0

    def receive(self, value: Any, now_ns: int) -> None:
        """Take a status that arrives now."""
        self._value, self._received_ns = value, now_ns

    def value(self, *, now_ns: int) -> Any:
        """Return the newest status, or None if it is too old or there is none.

        After the clock was set back its age is unknown, so it counts as too old.
        """
        return self._value if abs(now_ns - self._received_ns) <= self._timeout_ns else None


class SetpointStream:
    """Whether setpoints have run for long enough for an autopilot to accept them."""

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._newest_ns = 0

    def sent(self, *, now_ns: int) -> None:
        """Note that a setpoint is sent now."""
        if self._since_ns is None or self._stopped(now_ns):
            self._since_ns = now_ns
        self._newest_ns = now_ns

    def refusal(self, *, now_ns: int, silence: str) -> str | None:
        """Return why the autopilot would not accept the stream yet, or None.

        ``silence`` is the bridge's reason to send nothing, or empty.
        """
        reason = None
        if self._since_ns is None or self._stopped(now_ns):
            reason = "nothing reaches the autopilot"
        elif now_ns - self._since_ns < _NEEDED_NS:
            reason = "the setpoints have to run for a second first: ask again"
        return f"{reason} ({silence})" if reason and silence else reason

    def _stopped(self, now_ns: int) -> bool:
        return now_ns - self._newest_ns > _LONGEST_GAP_NS

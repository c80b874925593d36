"""What a bridge knows of its autopilot: the latest status."""

from __future__ import annotations

from typing import Any


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

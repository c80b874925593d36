"""Showing how far a flight is: one line that rewrites itself, or a line a second in a log."""

from __future__ import annotations

import sys
import time

_TERMINAL_PERIOD = 0.1
_LOG_PERIOD = 1.0


class Progress:
    """Prints the time flown and the position error to standard error."""

    def __init__(self, duration: float) -> None:
        self._duration = duration
        self._terminal = sys.stderr.isatty()
        self._period = _TERMINAL_PERIOD if self._terminal else _LOG_PERIOD
        self._started = time.monotonic()
        self._due = self._started

    @property
    def due(self) -> bool:
        """Whether it is time to show something."""
        return time.monotonic() >= self._due

    def show(self, flown: float, position_error: float | None) -> None:
        """Show ``flown`` seconds of flight and the position error [m]."""
        now = time.monotonic()
        self._due = now + self._period
        error = "" if position_error is None else f"   position error {position_error:6.3f} m"
        speed = flown / max(now - self._started, 1e-6)
        line = f"  {flown:6.1f} s of {self._duration:g} s   {speed:5.2f} x real time{error}"
        if self._terminal:
            print(f"\r{line:<78}", end="", file=sys.stderr, flush=True)
        else:
            print(line, file=sys.stderr, flush=True)

    def close(self) -> None:
        """End the line."""
        if self._terminal:
            print(file=sys.stderr)

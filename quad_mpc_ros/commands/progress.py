"""Showing progress: one line that rewrites itself in a terminal, or a line a second in a log."""

from __future__ import annotations

import sys
import time

_TERMINAL_PERIOD = 0.1
_LOG_PERIOD = 1.0


class ProgressLine:
    """A line on standard error, now and then another one."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._period = _TERMINAL_PERIOD if self._terminal else _LOG_PERIOD
        self._started = time.monotonic()
        self._due = self._started

    @property
    def seconds(self) -> float:
        """Time since the start [s]."""
        return time.monotonic() - self._started

    @property
    def due(self) -> bool:
        """Whether it is time to show something."""
        return time.monotonic() >= self._due

    def show(self, text: str) -> None:
        """Show a text in place of the last one."""
        self._due = time.monotonic() + self._period
        if self._terminal:
            print(f"\r  {text:<76}", end="", file=sys.stderr, flush=True)
        else:
            print(f"  {text}", file=sys.stderr, flush=True)

    def show_flight(self, flown: float, duration: float) -> None:
        """Show how much of a flight is flown, both in [s]."""
        speed = flown / max(self.seconds, 1e-6)
        self.show(f"{flown:6.1f} s of {duration:g} s   {speed:5.2f} x real time")

    def close(self) -> None:
        """End the line."""
        if self._terminal:
            print(file=sys.stderr)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Progress: one line, updated in a terminal, or a line per second in a log."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Iterator

_TERMINAL_PERIOD = 0.1
_LOG_PERIOD = 1.0


class ProgressLine:
    """A progress line on standard error."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._period = _TERMINAL_PERIOD if self._terminal else _LOG_PERIOD
        self._started = time.monotonic()
        self._due = self._started

    @property
    def seconds(self) -> float:
        """Time since the start [s]."""
        return time.monotonic() - self._started

    def show(self, text: str, *, always: bool = False) -> None:
        """Replace the text of the line if an update is due, or ``always``."""
        now = time.monotonic()
        if now < self._due and not always:
            return
        self._due = now + self._period
        if self._terminal:
            print(f"\r  {text:<76}", end="", file=sys.stderr, flush=True)
        else:
            print(f"  {text}", file=sys.stderr, flush=True)

    def show_flight(self, flown: float, duration: float) -> None:
        """Show the time flown and the duration of the flight [s]."""
        speed = flown / max(self.seconds, 1e-6)
        self.show(f"{flown:6.1f} s of {duration:g} s   {speed:5.2f} x real time")

    def close(self) -> None:
        """End the line."""
        if self._terminal:
            print(file=sys.stderr)


@contextlib.contextmanager
def interrupts() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C sets, where libraries would convert an exception."""
    interrupted = threading.Event()
    before = signal.signal(signal.SIGINT, lambda *_: interrupted.set())
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)

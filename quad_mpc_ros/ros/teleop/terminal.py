"""The terminal: keys as they are pressed, without waiting for a line, and as it was afterwards."""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import sys
import termios
import tty
from typing import Any

_MOST_AT_ONCE = 1024


def is_there() -> bool:
    """Return whether the process has a terminal, in the foreground."""
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):  # closed, or of another session
        return False


class Terminal:
    """Reads keys until :meth:`close`, which restores the terminal; so does the process's end.

    Signals stay: Ctrl-C interrupts.
    """

    def __init__(self) -> None:
        self._descriptor = sys.stdin.fileno()
        self._before: list[Any] | None = termios.tcgetattr(self._descriptor)
        atexit.register(self.close)
        tty.setcbreak(self._descriptor, termios.TCSANOW)

    def read(self) -> str:
        """Return what was typed since the last time."""
        if self._before is None or not select.select([self._descriptor], [], [], 0.0)[0]:
            return ""
        try:
            data = os.read(self._descriptor, _MOST_AT_ONCE)
        except OSError:  # hung up
            data = b""
        if not data:
            self.close()
        return data.decode(errors="ignore")

    @property
    def is_open(self) -> bool:
        """Whether keys can still come."""
        return self._before is not None

    def close(self) -> None:
        """Restore the terminal."""
        if self._before is None:
            return
        before, self._before = self._before, None
        with contextlib.suppress(termios.error):  # hung up: nothing to restore
            termios.tcsetattr(self._descriptor, termios.TCSANOW, before)
        atexit.unregister(self.close)

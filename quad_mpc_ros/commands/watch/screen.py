"""Where pictures go: the whole terminal, drawn anew, or lines of plain text; and Ctrl-C."""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Self

from rich.console import Console
from rich.live import Live

from quad_mpc_ros.commands.watch.panel import pictured
from quad_mpc_ros.commands.watch.view import VehicleView

LONGEST_WAIT = 0.2
"""How long [s] may be waited for anything without a look at whether it is stopped."""

_PLAIN_WIDTH = 120


class Screen:
    """Shows one picture after the other; the terminal is as before when the block ends.

    Inside the block Ctrl-C is noted in ``stopped``; pressed again it interrupts. As an exception
    alone it could be lost: in a callback of compiled code, or of another library.
    """

    def __init__(self, *, once: bool, console: Console | None = None) -> None:
        self._console = Console() if console is None else console
        self.once = once
        self.is_terminal = self._console.is_terminal
        if not self.is_terminal and console is None:
            self._console = Console(width=_PLAIN_WIDTH)
        self.stopped = False
        """Whether Ctrl-C was pressed."""
        self._live: Live | None = None
        self._ends = ExitStack()

    def __enter__(self) -> Self:
        before = signal.signal(signal.SIGINT, self._on_interrupt)
        self._ends.callback(signal.signal, signal.SIGINT, before)
        if self.is_terminal and not self.once:
            live = Live(console=self._console, screen=True, auto_refresh=False)
            self._live = self._ends.enter_context(live)
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.close()

    def sleep(self, seconds: float) -> None:
        """Wait, at most until Ctrl-C."""
        end = time.monotonic() + seconds
        while not self.stopped and (left := end - time.monotonic()) > 0.0:
            time.sleep(min(left, LONGEST_WAIT))

    def _on_interrupt(self, _number: int, _frame: object) -> None:
        if self.stopped:
            raise KeyboardInterrupt
        self.stopped = True

    def show(self, views: Sequence[VehicleView], *, title: str) -> None:
        """Show a picture of some vehicles."""
        picture = pictured(views, title=title)
        if self._live is None:
            self._console.print(picture)
        else:
            self._live.update(picture, refresh=True)

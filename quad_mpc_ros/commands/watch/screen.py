"""Where pictures go: the whole terminal, drawn anew, or lines of plain text."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Self

from rich.console import Console
from rich.live import Live

from quad_mpc_ros.commands.watch.panel import pictured
from quad_mpc_ros.commands.watch.view import VehicleView

_PLAIN_WIDTH = 120


class Screen:
    """Shows one picture after the other; the terminal is as before when the block ends."""

    def __init__(self, *, once: bool, console: Console | None = None) -> None:
        self._console = Console() if console is None else console
        self.once = once
        self.is_terminal = self._console.is_terminal
        if not self.is_terminal and console is None:
            self._console = Console(width=_PLAIN_WIDTH)
        self._live: Live | None = None
        self._ends = ExitStack()

    def __enter__(self) -> Self:
        if self.is_terminal and not self.once:
            live = Live(console=self._console, screen=True, auto_refresh=False)
            self._live = self._ends.enter_context(live)
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.close()

    def show(self, views: Sequence[VehicleView], *, title: str) -> None:
        """Show a picture of some vehicles."""
        picture = pictured(views, title=title)
        if self._live is None:
            self._console.print(picture)
        else:
            self._live.update(picture, refresh=True)

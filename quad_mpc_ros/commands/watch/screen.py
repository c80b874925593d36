"""The table of :mod:`.view` drawn with Rich: over the whole terminal, or as plain text."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Self

from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from quad_mpc_ros.commands.watch.view import Entry, Mark, VehicleView

_PLAIN_WIDTH = 120
_STYLES = {
    Mark.PLAIN: "",
    Mark.GOOD: "green",
    Mark.WARN: "yellow",
    Mark.BAD: "bold red",
    Mark.OLD: "magenta",
    Mark.MISSING: "dim",
}


class Screen:
    """Shows one table after the other; the terminal is as before when the block ends."""

    def __init__(self, *, whole_terminal: bool = True) -> None:
        console = Console()
        self.is_terminal = console.is_terminal
        self._console = console if self.is_terminal else Console(width=_PLAIN_WIDTH)
        self._whole_terminal = whole_terminal and self.is_terminal
        self._live: Live | None = None
        self._ends = ExitStack()

    def __enter__(self) -> Self:
        if self._whole_terminal:
            live = Live(console=self._console, screen=True, auto_refresh=False)
            self._live = self._ends.enter_context(live)
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.close()

    def show(self, views: Sequence[VehicleView], *, title: str) -> None:
        """Show a table of some vehicles."""
        table = drawn(views, title=title)
        if self._live is None:
            self._console.print(table)
        else:
            self._live.update(table, refresh=True)


def drawn(views: Sequence[VehicleView], *, title: str) -> RenderableType:
    """Return a table with a column for each vehicle, and the lines of the logs below it."""
    if not views:
        return Text(title)
    # Text, as everywhere: brackets in a name are no markup.
    table = Table(title=Text(title), box=box.SIMPLE_HEAD, title_justify="left")
    table.add_column("vehicle", style="bold", no_wrap=True)
    for view in views:
        table.add_column(Text(view.name), overflow="fold")
    for label in dict.fromkeys(label for view in views for label in view.entries):
        table.add_row(label, *(_text(view.entries.get(label)) for view in views))
    lines = [
        Text.assemble((f"{view.name} {node}  ", "bold"), _text(entry))
        for view in views
        for node, entry in view.log
    ]
    return Group(table, *lines)


def _text(entry: Entry | None) -> Text:
    return Text() if entry is None else Text(entry.text, style=_STYLES[entry.mark])

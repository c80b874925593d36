"""A picture in the terminal, drawn with Rich: a panel of one vehicle, a table of several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from quad_mpc_ros.commands.watch.vehicle import REMEMBERED
from quad_mpc_ros.commands.watch.view import Entry, Mark, VehicleView, extent
from quad_mpc_ros.control.lie import Array

_STYLES = {
    Mark.PLAIN: "",
    Mark.GOOD: "green",
    Mark.WARN: "yellow",
    Mark.BAD: "bold red",
    Mark.OLD: "magenta",
    Mark.MISSING: "dim",
}
_STACK_WIDTH = 36  # characters, at least
_TRAIL_SIZE = (26, 9)  # characters
# Braille: two columns of four dots in a character.
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_BRAILLE = 0x2800
_ROW = ("reference", "ground", "error", "odom", "command", "thrust scale", "battery", "fallbacks")


def pictured(views: Sequence[VehicleView], *, title: str) -> RenderableType:
    """Return the picture of some vehicles."""
    if not views:
        return Text(title)
    if len(views) == 1:
        return _panel(views[0], title=title)
    return _table(views, title=title)


def _panel(view: VehicleView, *, title: str) -> Panel:
    rung = Text.assemble(("commands  ", "bold"), (view.rung.text, _STYLES[view.rung.mark]))
    parts: list[RenderableType] = [rung, _Stacks(_boxes(view)), _box("nodes", view.nodes)]
    if view.log:
        parts.append(_box("log", view.log))
    # Text, as everywhere: what a name has in brackets is no markup.
    return Panel(Group(*parts), title=Text(f"{view.name}  {title}"), box=box.ROUNDED)


def _boxes(view: VehicleView) -> list[list[RenderableType]]:
    """Return what stands in each of three stacks."""
    learned = _box(f"learned [least, most in {REMEMBERED:g} s]", view.learned)
    return [
        [_box("flight", view.flight), _box("motion", view.motion)],
        [_box("timing", view.timing), _box("counters", view.counters)],
        [learned, _trail_box(view.trail)],
    ]


class _Stacks:
    """Stacks of boxes, side by side as far as the terminal is wide."""

    def __init__(self, stacks: Sequence[Sequence[RenderableType]]) -> None:
        self._stacks = stacks

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> RenderResult:
        count = max(1, min(options.max_width // _STACK_WIDTH, len(self._stacks)))
        grid = Table.grid(expand=True)
        for _column in range(count):
            grid.add_column(ratio=1)
        for first in range(0, len(self._stacks), count):
            grid.add_row(*(Group(*stack) for stack in self._stacks[first : first + count]))
        yield grid


def _box(name: str, entries: Sequence[Entry]) -> Panel:
    rows = Table.grid(padding=(0, 1))
    rows.add_column(style="bold", no_wrap=True)
    rows.add_column(overflow="fold")
    for entry in entries:
        rows.add_row(Text(entry.label), Text(entry.text, style=_STYLES[entry.mark]))
    return _framed(rows, name)


def _framed(content: RenderableType, name: str) -> Panel:
    return Panel(content, title=Text(name), title_align="left", box=box.SIMPLE_HEAD, padding=0)


def _trail_box(trail: Array) -> Panel:
    width, height = _TRAIL_SIZE
    lines = "\n".join(trail_lines(trail, width=width, height=height))
    name = f"from above, {extent(trail):.1f} m" if len(trail) else "from above, nothing yet"
    return _framed(Text(lines), name)


def _table(views: Sequence[VehicleView], *, title: str) -> Table:
    table = Table(title=Text(title), box=box.SIMPLE_HEAD, title_justify="left")
    for name in ("vehicle", "commands", *_ROW):
        table.add_column(name, overflow="fold")
    for view in views:
        entries = [view.rung, *(view.entry(label) for label in _ROW)]
        table.add_row(
            Text(view.name, style="bold"),
            *(Text(entry.text, style=_STYLES[entry.mark]) for entry in entries),
        )
    return table


def trail_lines(trail: Array, *, width: int, height: int) -> list[str]:
    """Return a trail (n, 3) [m] from above, x to the right and y up, in lines of Braille.

    Both axes have the same scale; a filled circle is where it ends.
    """
    dots = np.zeros((4 * height, 2 * width), dtype=bool)
    cells = np.full((height, width), _BRAILLE)
    if len(trail):
        places = trail[:, :2]
        low, size = places.min(axis=0), np.ptp(places, axis=0)
        room = np.array([2 * width - 1, 4 * height - 1])
        scale = float(np.min(room / np.maximum(size, 1e-3)))
        margin = 0.5 * (room - scale * size)
        places = _joined(margin + scale * (places - low))
        columns, rows = np.rint(places).astype(int).T
        dots[room[1] - rows, columns] = True
        blocks = dots.reshape(height, 4, width, 2)
        cells += np.einsum("hawb,ab->hw", blocks, _DOTS)
    lines = [[chr(cell) for cell in row] for row in cells.tolist()]
    if len(trail):
        lines[(room[1] - rows[-1]) // 4][columns[-1] // 2] = "●"
    return ["".join(line) for line in lines]


def _joined(places: Array) -> Array:
    """Return places (n, 2) with those between them, no more than one apart."""
    ways = np.abs(np.diff(places, axis=0)).max(axis=1)
    along = [
        start + np.linspace(0.0, 1.0, int(np.ceil(way)) + 1)[:, None] * (end - start)
        for start, end, way in zip(places[:-1], places[1:], ways, strict=True)
    ]
    return np.concatenate([places[:1], *along])

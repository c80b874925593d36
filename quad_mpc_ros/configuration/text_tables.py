"""Tables for people: lines of plain text for a terminal, and Markdown for a page."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence


def text_table(
    rows: Sequence[Sequence[str]], *, align: str, widths: Sequence[int] = (), gap: str = "  "
) -> list[str]:
    """Lay out rows of equally many cells in columns; return a line a row.

    Args:
        rows: The cells; a header is a row like the others, an empty row is an empty line.
        align: A letter a column: ``l`` for left, ``r`` for right.
        widths: The least width of each column, in which a gap may be included. A column is as
            wide as its widest cell where that is more.
        gap: What stands between two columns.
    """
    least = widths or [0] * len(align)
    widest = [
        max([width, *(len(row[column]) for row in rows if row)])
        for column, width in enumerate(least)
    ]
    return [
        gap.join(
            cell.rjust(width) if side == "r" else cell.ljust(width)
            for cell, side, width in zip(row, align, widest, strict=True)
        ).rstrip()
        if row
        else ""
        for row in rows
    ]


def labelled(label: str, text: str, *, indent: int, width: int) -> list[str]:
    """Return a label with text beside it, wrapped into the column that begins at ``indent``."""
    return textwrap.wrap(
        text, width, initial_indent=label.ljust(indent), subsequent_indent=" " * indent
    ) or [label.rstrip()]


def markdown_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], *, align: str = ""
) -> str:
    """Return a table of Markdown; ``align`` as above, all columns to the left without it."""
    sides = align or "l" * len(header)
    rule = "|".join("---:" if side == "r" else "---" for side in sides)
    lines = [_markdown_row(header), f"|{rule}|", *map(_markdown_row, rows)]
    return "\n".join(lines)


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

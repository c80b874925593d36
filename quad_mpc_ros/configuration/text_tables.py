# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of plain text for a terminal."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(
    rows: Sequence[Sequence[str]], *, align: str, widths: Sequence[int] = (), gap: str = "  "
) -> list[str]:
    """Lay out rows of equally many cells in columns; return one line per row.

    Args:
        rows: The cells; a header is an ordinary row, an empty row is an empty line.
        align: One letter per column: ``l`` for left, ``r`` for right.
        widths: The minimum width of each column. A column is at least as wide as its widest cell.
        gap: The space between two columns, never empty.
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

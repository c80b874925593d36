# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of Markdown, which the benches print for a page."""

from __future__ import annotations

from collections.abc import Sequence


def markdown_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], *, align: str = ""
) -> str:
    """Return a table of Markdown; ``align`` has a letter a column, ``l`` or ``r``."""
    sides = align or "l" * len(header)
    rule = "|".join("---:" if side == "r" else "---" for side in sides)
    lines = [_markdown_row(header), f"|{rule}|", *map(_markdown_row, rows)]
    return "\n".join(lines)


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

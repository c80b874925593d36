# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The table of the flights of a campaign."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from quad_mpc_ros.configuration.atomic_file import write_atomically

NUMBER = "flight"
VERDICT = ("error", "crashed", "crash", "crash_time_s")
"""Columns of the error, and of the crash with its kind and time."""

CSV_NAME = "flights.csv"
Row = Mapping[str, Any]
"""Values of a flight by column: numbers, texts, None for no value."""


def write_table(folder: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    """Write ``flights.csv``, one row per flight. Raises ``OSError``.

    Columns in order: ``flight``, the number; the varied parameters, vectors as ``name.0`` and so
    on; :data:`VERDICT`; the figures. Cells without a value are empty.
    """
    write_atomically(folder / CSV_NAME, csv_text(rows, names))


def csv_text(rows: Iterable[Row], names: Sequence[str]) -> str:
    """Return a table with a header and a line for each row, empty cells for no value."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_cell(row.get(name)) for name in names] for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float) and not math.isfinite(value):
        return ""
    return "" if value is None else value

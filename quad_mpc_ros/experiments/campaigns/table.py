"""The table of a campaign: one row a flight, as ``flights.csv`` and ``flights.parquet``.

Columns in order: ``flight``, the number; every varied parameter by its name, vectors as ``name.0``
and so on; :data:`VERDICT`; then the figures. A cell that has no value is empty.
"""

from __future__ import annotations

import csv
import importlib
import importlib.util
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.atomic_file import write_atomically

NUMBER = "flight"
VERDICT = ("error", "crashed", "crash", "crash_time_s")
"""Why the flight raised, whether it crashed, how, and when."""

_TEXTS = ("error", "crash")

CSV_NAME, PARQUET_NAME = "flights.csv", "flights.parquet"

Row = Mapping[str, Any]
"""A flight by the names of the columns: numbers, texts, None for no value."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CampaignTable:
    """The flights of a campaign, in order of their numbers.

    Attributes:
        columns: Each column (n,) by its name, in order: floats with NaN for no value, ``crashed``
            as bool, texts as ``str`` with "" for no value.
        varied: The names of the varied parameters among them.
        figures: The names of the figures among them.
    """

    columns: Mapping[str, NDArray[Any]]
    varied: tuple[str, ...]
    figures: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.columns[NUMBER])

    @property
    def flown(self) -> NDArray[np.bool_]:
        """Which flights raised no error (n,)."""
        return np.asarray(self.columns["error"] == "")

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """Which flights crashed (n,)."""
        return np.asarray(self.columns["crashed"], dtype=np.bool_)


def write_table(folder: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    """Write the rows, in order of their numbers, as CSV and, where pyarrow is, as Parquet.

    Equal rows give equal bytes. Raises ``OSError``.
    """
    ordered = sorted(rows, key=lambda row: int(row[NUMBER]))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_cell(row.get(name)) for name in names] for row in ordered)
    write_atomically(folder / CSV_NAME, text.getvalue(), overwrite=True)
    if has_parquet():
        _write_parquet(folder / PARQUET_NAME, ordered, names)


def read_table(folder: Path) -> CampaignTable:
    """Return the table of a campaign's folder. Raises :class:`UserError` for a folder of none."""
    path = folder / CSV_NAME
    try:
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
    except (OSError, UnicodeDecodeError, ValueError, csv.Error) as error:
        raise UserError(f"{folder}: no table of a campaign: {path}: {error}") from error
    if header[:1] != [NUMBER] or not set(VERDICT) <= set(header):
        raise UserError(f"{path}: not the table of a campaign: its columns are {header[:4]} …")
    try:
        columns = {
            name: _column(name, cells)
            for name, cells in zip(header, _transposed(rows, len(header)), strict=True)
        }
    except ValueError as error:  # rows of unequal length, a number of a flight that is none
        raise UserError(f"{path}: not the table of a campaign: {error}") from error
    first = header.index(VERDICT[0])
    return CampaignTable(
        columns=columns,
        varied=tuple(header[1:first]),
        figures=tuple(name for name in header[first:] if name not in VERDICT),
    )


def has_parquet() -> bool:
    """Whether ``flights.parquet`` can be written: whether pyarrow is installed."""
    return importlib.util.find_spec("pyarrow") is not None


def _transposed(rows: Sequence[Sequence[str]], width: int) -> Iterable[Sequence[str]]:
    return zip(*rows, strict=True) if rows else [()] * width


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float) and not math.isfinite(value):
        return ""
    return "" if value is None else value


def _column(name: str, cells: Iterable[str]) -> NDArray[Any]:
    if name == NUMBER:
        return np.array([int(cell) for cell in cells], dtype=np.int64)
    if name == "crashed":
        return np.array([cell == "1" for cell in cells], dtype=np.bool_)
    texts = list(cells)
    if name in _TEXTS:
        return np.array(texts, dtype=np.str_)
    try:
        return np.array([float(cell) if cell else math.nan for cell in texts])
    except ValueError:
        return np.array(texts, dtype=np.str_)


def _write_parquet(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    pyarrow = importlib.import_module("pyarrow")
    parquet = importlib.import_module("pyarrow.parquet")
    table = pyarrow.table({name: [row.get(name) for row in rows] for name in names})
    part = path.with_name(f".{path.name}.part")
    parquet.write_table(table, part)
    part.replace(path)

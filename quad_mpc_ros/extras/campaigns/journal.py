# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The finished flights of a campaign on disk: journal and table.

The journal has one line for each flight, in order of their completion. Its first line identifies
the campaign. A kill may truncate the last line, which is then ignored.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from quad_mpc_ros import __version__
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.atomic_file import write_atomically

NAME = "journal.jsonl"
NUMBER = "flight"
VERDICT = ("error", "crashed", "crash", "crash_time_s")
"""Columns of the error, and of the crash with its kind and time."""

CSV_NAME = "flights.csv"
Row = Mapping[str, Any]
"""Values of a flight by column: numbers, texts, None for no value."""


class Journal:
    """The rows of finished flights, in memory and in the file."""

    def __init__(self, folder: Path, *, campaign_text: str) -> None:
        """Begin or continue the journal in a folder.

        Raises :class:`UserError` for the journal of another campaign or version.
        """
        self._path = folder / NAME
        self._header = {
            "campaign": hashlib.sha256(campaign_text.encode()).hexdigest(),
            "version": __version__,
        }
        self.rows: dict[int, Row] = {}
        whole = self._read() if self._path.exists() else 0
        self._file = self._path.open("ab")
        self._file.truncate(whole)
        if whole == 0:
            self._write([self._header])

    def add(self, rows: Iterable[Row]) -> None:
        """Add the rows of flights; they are on disk when this returns."""
        new = {int(row[NUMBER]): row for row in rows}
        self._write(new.values())
        self.rows.update(new)

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._file.close()

    def _write(self, values: Iterable[Row]) -> None:
        text = "".join(json.dumps(value, allow_nan=False) + "\n" for value in values)
        self._file.write(text.encode())
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self) -> int:
        """Read the complete lines of the file and return their end [bytes]."""
        end, header = 0, None
        with self._path.open("rb") as file:
            for line in file:
                value = _parsed(line)
                if value is None:
                    break
                end += len(line)
                if header is None:
                    header = value
                    self._check(header)
                else:
                    self.rows[int(value[NUMBER])] = value
        return end

    def _check(self, header: dict[str, Any]) -> None:
        if header.get("campaign") != self._header["campaign"]:
            raise UserError(
                f"{self._path.parent}: its campaign.yaml has changed since its first flight: "
                "start again with another --out"
            )
        if header.get("version") != __version__:
            raise UserError(
                f"{self._path.parent}: started by quad_mpc_ros {header.get('version')}, this is "
                f"{__version__}: their flights must not be mixed; use another --out"
            )


def _parsed(line: bytes) -> dict[str, Any] | None:
    """Return the value of a line; None for a truncated line."""
    if not line.endswith(b"\n"):
        return None
    try:
        value = json.loads(line)
    except ValueError:
        return None
    return value if isinstance(value, dict) else None


def write_table(folder: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    """Write ``flights.csv``, one row per flight, ordered by number. Raises ``OSError``.

    Columns in order: ``flight``, the number; the varied parameters, vectors as ``name.0`` and so
    on; :data:`VERDICT`; the figures. Cells without a value are empty.
    """
    ordered = sorted(rows, key=lambda row: int(row[NUMBER]))
    write_atomically(folder / CSV_NAME, csv_text(ordered, names), overwrite=True)


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

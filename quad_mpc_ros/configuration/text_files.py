# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading text files and tables of comma-separated values; YAML is read by :mod:`.ros_yaml`."""

from __future__ import annotations

import csv
from pathlib import Path

from quad_mpc_ros.configuration.errors import UserError, os_reason

_COMMENT = "#"


def file_text(path: Path) -> str:
    """Return the text of a file; raise :class:`UserError` if reading fails."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {os_reason(error)}") from error
    except UnicodeDecodeError as error:
        raise UserError(
            f"{path}: not UTF-8 at byte {error.start}: expected a text file in UTF-8"
        ) from error


def read_csv_table(path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows of a table, without empty lines and comments.

    Each is the number of its last line, from 1, and its cells without surrounding spaces.

    Raises :class:`UserError` for a file that cannot be read and for unclosed quotes.
    """
    numbered = [
        (number, line)
        for number, line in enumerate(file_text(path).splitlines(), start=1)
        if line.strip()
    ]
    lines = [(n, line) for n, line in numbered if not line.lstrip().startswith(_COMMENT)]
    reader = csv.reader((line for _, line in lines), strict=True, skipinitialspace=True)
    rows = []
    try:
        for cells in reader:
            stripped = [cell.strip() for cell in cells]
            rows.append((lines[reader.line_num - 1][0], stripped))
    except csv.Error as error:
        line = lines[max(reader.line_num, 1) - 1][0]
        raise UserError(f"{path}: line {line}: {error}") from error
    return rows

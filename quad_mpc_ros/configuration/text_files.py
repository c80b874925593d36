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
    lines = file_text(path).splitlines()
    reader = csv.reader(
        ("" if line.lstrip().startswith(_COMMENT) else line for line in lines),
        strict=True,
        skipinitialspace=True,
    )
    try:
        rows = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except csv.Error as error:
        raise UserError(f"{path}: line {max(reader.line_num, 1)}: {error}") from error
    return [(line, cells) for line, cells in rows if cells not in ([], [""])]

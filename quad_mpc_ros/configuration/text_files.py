"""Reading text files and tables of comma-separated values; YAML is read by :mod:`.ros_yaml`."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import NamedTuple

from quad_mpc_ros.configuration.errors import UserError, os_reason

_COMMENT = "#"
_OTHER_SEPARATORS = {";": "';'", "\t": "tabs", "|": "'|'", " ": "spaces"}
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]+)?")


class CsvRow(NamedTuple):
    """The cells of a row without surrounding spaces, and the number of its last line, from 1."""

    line: int
    cells: list[str]


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


def read_csv_table(path: Path) -> list[CsvRow]:
    """Return the rows of a table, without empty lines and comments.

    Raises :class:`UserError` for a file that cannot be read, a separator other than the comma and
    unclosed quotes.
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
            rows.append(CsvRow(lines[reader.line_num - 1][0], stripped))
    except csv.Error as error:
        line = lines[max(reader.line_num, 1) - 1][0]
        raise UserError(f"{path}: line {line}: {error}") from error
    if rows and len(rows[0].cells) == 1:
        _refuse_other_separator(path, lines)
    return rows


def has_decimal_comma(text: str) -> bool:
    """Return whether a text is a number with a decimal comma."""
    return _DECIMAL_COMMA.fullmatch(text.strip()) is not None


def _refuse_other_separator(path: Path, lines: list[tuple[int, str]]) -> None:
    """Reject a table with a separator other than the comma."""
    number, header = lines[0]
    found = next((each for each in _OTHER_SEPARATORS if each in header.strip()), None)
    if found is None:
        return
    decimals = any(has_decimal_comma(cell) for _, line in lines[1:] for cell in line.split(found))
    more = " and decimals are written with a comma, expected ',' and a point" if decimals else ""
    raise UserError(
        f"{path}: line {number}: values are separated by {_OTHER_SEPARATORS[found]}"
        f"{more or ', expected a comma'}; export the table again"
    )

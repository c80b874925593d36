"""What a campaign has flown so far, on disk: a line a flight, in the order in which they came.

The first line says of which campaign. A kill may cut the last line; what is before it counts.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

from quad_mpc_ros import __version__
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.table import NUMBER, Row

NAME = "journal.jsonl"


class Journal:
    """The rows of the flights flown, appended to the file and kept."""

    def __init__(self, folder: Path, *, campaign_text: str) -> None:
        """Begin the journal of a folder, or continue it.

        Raises :class:`UserError` where it is that of another campaign or of another version.
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
        """Add the rows of flights; when this returns, the disk has them."""
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
        """Take the whole lines of the file and return where they end."""
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
                f"{self._path.parent}: begun by quad_mpc_ros {header.get('version')}, this is "
                f"{__version__}: flights of both do not mix; start again with another --out"
            )


def _parsed(line: bytes) -> dict[str, Any] | None:
    """Return the value of a whole line, None of one that was cut."""
    if not line.endswith(b"\n"):
        return None
    try:
        value = json.loads(line)
    except ValueError:
        return None
    return value if isinstance(value, dict) else None

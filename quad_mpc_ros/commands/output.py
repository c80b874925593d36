"""Where commands write: files and folders that are new, and whole or not at all."""

from __future__ import annotations

import contextlib
import datetime
import itertools
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.atomic_file import write_atomically


def check_writable(option: str, path: Path | None, *, overwrite: bool) -> None:
    """Refuse what an option named before any work is done for it. Raises :class:`UserError`."""
    if path is None:
        return
    if path.is_dir():
        raise UserError(f"{option}: {path} is a folder, expected a file")
    if path.exists() and not overwrite:
        raise UserError(
            f"{option}: {path} exists and is not overwritten; give another name or --overwrite"
        )
    above = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
        raise UserError(f"{option}: {path} cannot be written: {above} is no folder to write into")


def write_new(option: str, path: Path, text: str, *, overwrite: bool) -> None:
    """Write a file and the folders above it. Other programs see all of it or what was there.

    Raises :class:`UserError` for a file that exists by now, or that cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text, overwrite=overwrite)
    except OSError as error:
        raise UserError(f"{option}: {path} cannot be written: {error.strerror}") from error


def create_out(label: str) -> Path:
    """Make a folder for a run that was not given one, and return it.

    Another run may have begun in the same second. Where no folder can be made, who writes into it
    says why.
    """
    now = datetime.datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    names = itertools.chain([label], (f"{label}_{number}" for number in itertools.count(1)))
    while True:
        out = Path("runs") / f"{now}_{next(names)}"
        try:
            out.mkdir(parents=True)
        except OSError:
            if out.is_dir():
                continue
        return out


def prepared_out(out: Path, *, holds: Sequence[str] = ("bag", "summary.json", "figures")) -> Path:
    """Make the folder of a run and return it; refuse one that has what it is to hold.

    Raises :class:`UserError`.
    """
    for name in holds:
        if (out / name).exists():
            raise UserError(
                f"--out: {out / name} exists and is not overwritten; give a new folder"
            )
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(f"--out: {out} cannot be written: {error.strerror}") from error
    return out


@contextlib.contextmanager
def results_in(out: Path) -> Iterator[None]:
    """Write results into a folder. Raises :class:`UserError` when that fails."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{out}: results cannot be written: {error.strerror}") from error


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write strict JSON: no NaN, no infinity. Raises ``OSError``."""
    path.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n", encoding="utf-8")

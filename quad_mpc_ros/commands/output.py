# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Output files and folders of commands; existing files are kept, new files are complete."""

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
    """Check an output file before the work starts. Raises :class:`UserError`."""
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
        raise UserError(f"{option}: {path} cannot be written: {above} is not a writable folder")


def write_new(option: str, path: Path, text: str, *, overwrite: bool) -> None:
    """Write a file atomically, and create missing folders.

    Raises :class:`UserError` for a file that exists by now, or cannot be written.
    """
    check_writable(option, path, overwrite=overwrite)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text)
    except OSError as error:
        raise UserError(f"{option}: {path} cannot be written: {error.strerror}") from error


def create_out(label: str) -> Path:
    """Create and return a folder for a run without ``--out``.

    Another run may have started in the same second. If no folder can be created, writing into the
    folder raises the error.
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
    """Create and return the folder of a run.

    Raises :class:`UserError` if the folder already has one of ``holds`` or cannot be written.
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
    """Write results into a folder. Raises :class:`UserError` if this fails."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{out}: results cannot be written: {error.strerror}") from error


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write strict JSON: no NaN, no infinity. Raises ``OSError``."""
    path.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n", encoding="utf-8")

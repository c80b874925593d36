"""Writing a file that was asked for: whole or not at all, and over nothing unless told to."""

from __future__ import annotations

from pathlib import Path

from quad_mpc_ros.atomic_file import write_atomically
from quad_mpc_ros.configuration import UserError


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


def write_new(option: str, path: Path, text: str, *, overwrite: bool) -> None:
    """Write a file and what leads to it. Whoever looks finds all of it or what was there before.

    Raises :class:`UserError` for a file that exists by now, or that cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text, overwrite=overwrite)
    except OSError as error:
        raise UserError(f"{option}: {path} cannot be written: {error.strerror}") from error

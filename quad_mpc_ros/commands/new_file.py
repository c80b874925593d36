"""Writing a file that was asked for: whole or not at all, and over nothing unless told to."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

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
        draft = _draft(path, text)
        try:
            if overwrite:
                draft.replace(path)
            else:
                _put(draft, path)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise UserError(f"{option}: {path} cannot be written: {error.strerror}") from error


def _put(draft: Path, path: Path) -> None:
    """Give a file another name that nothing has yet."""
    try:
        path.hardlink_to(draft)  # looking first would leave a moment for another to write it
    except FileExistsError:
        raise
    except OSError:  # a file system without links, as of memory cards
        if path.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        draft.replace(path)


def _draft(path: Path, text: str) -> Path:
    """Return a file beside ``path`` with the text, which the disk has."""
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False
    ) as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    draft = Path(file.name)
    # Such a file is for its owner alone at first.
    umask = os.umask(0)
    os.umask(umask)
    draft.chmod(0o666 & ~umask)
    return draft

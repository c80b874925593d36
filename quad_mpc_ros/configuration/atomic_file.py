# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Atomic writing of files: readers find the new file or the previous one."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def write_atomically(path: Path, text: str, *, overwrite: bool = True) -> None:
    """Write a text file as UTF-8, and flush it to the disk.

    Raises ``FileExistsError`` for an existing file, unless ``overwrite`` is set, and ``OSError``
    for other failures; ``path`` is then unchanged.
    """
    with placed(path, overwrite=overwrite) as draft, draft.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def placed(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary name whose file becomes ``path``; raises like :func:`write_atomically`."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        draft = Path(folder) / path.name
        yield draft
        if overwrite:
            draft.replace(path)
        else:
            _put(draft, path)


def _put(draft: Path, path: Path) -> None:
    """Move a file to a name that does not exist."""
    try:
        path.hardlink_to(draft)  # atomic, unlike a check before
    except FileExistsError:
        raise
    except OSError:  # a file system without links, as of memory cards
        if path.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        draft.replace(path)

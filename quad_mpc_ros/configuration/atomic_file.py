# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Atomic writing of files: readers find the new file or the previous one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def write_atomically(path: Path, text: str) -> None:
    """Write a text file as UTF-8, and flush it to the disk.

    Raises ``OSError`` for failures; ``path`` is then unchanged.
    """
    with placed(path) as draft, draft.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def placed(path: Path) -> Iterator[Path]:
    """Yield a temporary name whose file becomes ``path``; raises like :func:`write_atomically`."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        draft = Path(folder) / path.name
        yield draft
        draft.replace(path)

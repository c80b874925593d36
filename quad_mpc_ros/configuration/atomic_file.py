"""Writing a file in one piece: readers find the whole new file, or the one before."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def write_atomically(path: Path, text: str, *, overwrite: bool = True) -> None:
    """Write a text file as UTF-8; when this returns, the disk has it.

    Raises ``FileExistsError`` for one that exists, unless ``overwrite`` is set, and ``OSError``
    for everything else that the disk refuses. Then ``path`` is as it was.
    """
    with placed(path, overwrite=overwrite) as draft, draft.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def placed(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a name to write to, of what becomes ``path`` at the end.

    Raises as :func:`write_atomically`.
    """
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        draft = Path(folder) / path.name
        yield draft
        if overwrite:
            draft.replace(path)
        else:
            _put(draft, path)


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

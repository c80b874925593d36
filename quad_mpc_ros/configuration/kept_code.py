"""The machine code that is kept on disk as a whole: whether it is complete and undamaged."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.configuration.compilation import PACKAGE, cache_folder


class KeptCode:
    """All machine code of the package on disk, and a mark that says that it is complete.

    The mark lists the checksum of each file: Numba has none, and raises or crashes when it loads a
    damaged file.
    """

    def __init__(self) -> None:
        """Raise :class:`OSError` where there is no place that can be written."""
        sources = [file for file in PACKAGE.rglob("*.py") if "@compiled" in file.read_text()]
        folders = {cache_folder(file.parent) for file in sources}
        self._folders = sorted(folder for folder in folders if folder is not None)
        if not self._folders:
            raise OSError("no folder for machine code can be written; NUMBA_CACHE_DIR names one")
        self._place = self._folders[0].parent
        self._mark = self._place / f"complete-{_digest(*(f.name for f in self._folders))}"
        # Numba takes code as stale when its source was written again, whatever is in it.
        self._written = _digest(*(f"{file} {file.stat().st_mtime}" for file in sorted(sources)))

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Wait until no other process compiles everything, and keep others waiting."""
        with (self._place / "compile.lock").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def count(self) -> int:
        """Return how many functions are kept."""
        return sum(file.suffix == ".nbc" for file in self._files())

    def is_complete(self) -> bool:
        """Return whether everything was compiled and no file has changed since."""
        written, marked = self._marked()
        return written == self._written and not self._damaged(marked)

    def remove_damaged(self) -> int:
        """Remove each function with a file that differs from the mark; return how many files.

        Without a mark nothing is known of any file, and all are removed.
        """
        _, marked = self._marked()
        damaged = {_function(name) for name in self._damaged(marked)}
        removed = [f for f in self._files() if not marked or _function(str(f)) in damaged]
        for file in removed:
            file.unlink(missing_ok=True)
        return len(removed)

    def remove_all(self) -> None:
        """Remove everything, so that it is compiled again."""
        self._mark.unlink(missing_ok=True)
        self.remove_damaged()

    def mark_complete(self) -> None:
        """State that everything is compiled, and remove what was compiled of former sources."""
        lines = [self._written, *(f"{_checksum(file)} {file}" for file in self._files())]
        write_atomically(self._mark, "\n".join(lines))
        if self._place != PACKAGE / "__pycache__":
            return  # another installation may use it as well
        for folder in self._place.glob("compiled-*"):
            if folder not in self._folders:
                shutil.rmtree(folder, ignore_errors=True)
        for mark in self._place.glob("complete-*"):
            if mark != self._mark:
                mark.unlink(missing_ok=True)

    def _files(self) -> list[Path]:
        return sorted(file for folder in self._folders for file in folder.rglob("*.nb[ci]"))

    def _marked(self) -> tuple[str, dict[str, str]]:
        """Return when the sources were written, and checksums by file; nothing without a mark."""
        try:
            written, *lines = self._mark.read_text().splitlines()
        except (OSError, ValueError):
            return "", {}
        parts = (line.partition(" ") for line in lines)
        return written, {name: checksum for checksum, _, name in parts}

    def _damaged(self, marked: dict[str, str]) -> list[str]:
        return [name for name, checksum in marked.items() if _checksum(Path(name)) != checksum]


def _checksum(file: Path) -> str:
    try:
        return hashlib.blake2b(file.read_bytes(), digest_size=16).hexdigest()
    except OSError:
        return "missing"


def _digest(*parts: str) -> str:
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=10).hexdigest()


def _function(file: str) -> str:
    """Return what the names of a function's index and machine code have in common."""
    return file.partition(".py3")[0]

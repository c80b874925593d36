"""Compiling functions by Numba, with machine code that is kept on disk for the next start.

A function's machine code contains what it calls, and the constants that it reads, of other files
too. Numba's cache asks only whether the function's own file has changed, so it is kept in a folder
that is named after a digest of all sources that compiled code is made of: stale code is in another
folder and never used.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba

_P = ParamSpec("_P")
_T = TypeVar("_T")

PACKAGE = Path(__file__).resolve().parents[1]

SHARED = (
    "configuration/compilation.py",
    "configuration/records.py",
    "control/lie",
    "control/model",
    "control/ocp",
    "control/estimation",
)
"""From where compiled code takes functions and constants, beside its own folder: a test looks."""

FUNCTIONS: list[Any] = []
"""Numba's dispatchers of all compiled functions that have been imported."""


def compiled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile a function when it is first called, and keep the machine code on disk.

    Floating point is strict: a flight is the same, bit for bit, in every process of a machine.
    """
    folder = cache_folder(Path(function.__code__.co_filename).resolve().parent)
    with _cached_in(folder):
        dispatcher = numba.njit(cache=folder is not None, error_model="numpy")(function)
    FUNCTIONS.append(dispatcher)
    return cast(Callable[_P, _T], dispatcher)


def compiled_here() -> int:
    """Return how many functions this process has compiled, because no machine code was kept."""
    return sum(sum(function.stats.cache_misses.values()) for function in FUNCTIONS)


@functools.cache
def cache_folder(room: Path) -> Path | None:
    """Return where machine code of a room's sources is kept, None where nothing can be written.

    That is beside the package, else in the user's cache; ``NUMBA_CACHE_DIR`` names another place.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    places = [Path(given)] if given else [PACKAGE / "__pycache__", user / "quad_mpc_ros"]
    for place in places:
        folder = place / f"compiled-{digest_of_sources(room)}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return None


@functools.cache
def digest_of_sources(room: Path) -> str:
    """Return a digest of what machine code of a room is made of: sources, Numba, NumPy."""
    digest = hashlib.blake2b(digest_size=10)
    for name in ("numba", "llvmlite", "numpy"):
        digest.update(f"{name} {importlib.metadata.version(name)}\0".encode())
    for file in sorted(sources(room)):
        digest.update(f"{file.name}\0".encode() + file.read_bytes())
    return digest.hexdigest()


def sources(room: Path) -> Iterator[Path]:
    """Yield the files that a room's machine code may be made of: shared ones, and its door's."""
    for name in SHARED:
        place = PACKAGE / name
        yield from [place] if place.suffix else place.glob("*.py")
    is_inner = room.parent.parent == PACKAGE and room.parent.name != "control"
    yield from (room.parent if is_inner else room).rglob("*.py")


@contextmanager
def _cached_in(folder: Path | None) -> Iterator[None]:
    """Let Numba keep what is decorated meanwhile in a folder."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder or before)
    try:
        yield
    finally:
        config.CACHE_DIR = before

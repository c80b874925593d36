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
import logging
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba

from quad_mpc_ros.configuration.trust import distrust

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
    return _compiled(function, nogil=False)


def compiled_beside_others(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile as :func:`compiled`; while it runs, Python's other threads run as well."""
    return _compiled(function, nogil=True)


def _compiled(function: Callable[_P, _T], *, nogil: bool) -> Callable[_P, _T]:
    folder = cache_folder(Path(function.__code__.co_filename).resolve().parent)
    kept = folder is not None
    with _cached_in(folder):
        dispatcher = numba.njit(cache=kept, error_model="numpy", nogil=nogil)(function)
    FUNCTIONS.append(dispatcher)
    return cast(Callable[_P, _T], dispatcher)


def compiled_here() -> int:
    """Return how many functions this process has compiled, because no machine code was kept."""
    return sum(sum(function.stats.cache_misses.values()) for function in FUNCTIONS)


@functools.cache
def cache_folder(room: Path) -> Path | None:
    """Return where machine code of a room's sources is kept, None where nothing can be written.

    That is beside the package, else in the user's cache; ``NUMBA_CACHE_DIR`` names another place
    before these. Machine code is loaded without a further look, so places are passed over where
    others could have put some.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    installed = PACKAGE / "__pycache__"
    faults = []
    found = None
    for place in [*([Path(given)] if given else []), installed, user / "quad_mpc_ros"]:
        try:
            fault, folder = _kept_in(place, room, mode=0o755 if place == installed else 0o700)
        except OSError:
            continue
        if not fault:
            found = folder
            break
        faults.append((place, fault))
    for place, fault in faults:
        _tell(place, fault, found.parent if found is not None else None)
    return found


def _kept_in(place: Path, room: Path, *, mode: int) -> tuple[str, Path]:
    """Return a room's folder in a place, and why it may not be used, or nothing.

    Raises :class:`OSError` where nothing can be written.
    """
    folder = place / f"compiled-{digest_of_sources(room)}"
    place.mkdir(mode=mode, parents=True, exist_ok=True)
    fault = distrust(place, deep=False)
    if not fault:
        folder.mkdir(mode=mode, exist_ok=True)
        fault = distrust(folder)
    if not fault:
        with tempfile.TemporaryFile(dir=folder):
            pass
    return fault, folder


@functools.cache
def _tell(place: Path, fault: str, instead: Path | None) -> None:
    """Log, once for a place, that it is passed over."""
    then = f"that in {instead}" if instead is not None else "all is compiled at each start"
    logging.getLogger(__name__).warning(
        "machine code kept in %s is not used, for %s; instead %s", place, fault, then
    )


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

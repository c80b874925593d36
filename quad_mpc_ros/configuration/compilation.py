# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Compiling functions with Numba and keeping the machine code in a cache on disk.

Numba looks a function up by the path and the modification time of its file. Numba does not check
the files of called functions. The cache is therefore a folder named after a digest of all sources
of compiled code, with paths and times, and of the compiling versions.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np

_P = ParamSpec("_P")
_T = TypeVar("_T")

PACKAGE = Path(__file__).resolve().parents[1]

SOURCES = (
    "configuration/compilation.py",
    "configuration/records.py",
    "control/lie",
    "control/model",
    "control/ocp",
    "control/estimation",
    "control/safety",
    "simulation",
    "extras/obstacles",
    "extras/plants",
    "analysis/identification",
)
"""Files and folders of compiled functions and of the constants that they read."""

FUNCTIONS: list[Any] = []
"""Numba's dispatchers of all compiled functions that have been imported."""


def compiled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile a function on its first call, and keep the machine code on disk.

    Floating point is strict: a flight is the same, bit for bit, in every process of a machine.
    """
    return _compiled(function, nogil=False)


def compiled_without_gil(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile like :func:`compiled`, without holding the GIL."""
    return _compiled(function, nogil=True)


def _compiled(function: Callable[_P, _T], *, nogil: bool) -> Callable[_P, _T]:
    folder = cache_folder()
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder or before)
    try:
        dispatcher = numba.njit(cache=folder is not None, error_model="numpy", nogil=nogil)(
            function
        )
    finally:
        config.CACHE_DIR = before
    FUNCTIONS.append(dispatcher)
    return cast(Callable[_P, _T], dispatcher)


def functions_compiled() -> int:
    """Return how many functions missing in the cache this process has compiled."""
    return sum(sum(function.stats.cache_misses.values()) for function in FUNCTIONS)


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder of the compile cache; None if it cannot be written.

    The folder is in ``NUMBA_CACHE_DIR``, by default in the user's cache folder.
    """
    try:
        user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        place = Path(os.environ.get("NUMBA_CACHE_DIR") or user / "quad_mpc_ros")
        folder = place / f"compiled-{_digest()}"
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):  # RuntimeError: the user has no home folder
        return None


def cached_functions() -> int:
    """Return the number of functions in the compile cache."""
    folder = cache_folder()
    return 0 if folder is None else sum(1 for _ in folder.rglob("*.nbc"))


def _digest() -> str:
    """Return a digest of sources and versions; Numba's index distinguishes processors."""
    versions = (numba.__version__, np.__version__, platform.python_version())
    digest = hashlib.blake2b(" ".join(versions).encode(), digest_size=10)
    for file in sorted(source_files()):
        digest.update(f"{file}\0{file.stat().st_mtime_ns}\0".encode() + file.read_bytes())
    return digest.hexdigest()


def source_files() -> Iterator[Path]:
    """Yield the files of :data:`SOURCES`."""
    for name in SOURCES:
        place = PACKAGE / name
        yield from [place] if place.suffix else place.rglob("*.py")

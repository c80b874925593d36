"""Compiling functions by Numba, with machine code that is kept on disk for the next start.

A function's machine code contains what it calls, and the constants that it reads, of other files
too. Numba asks only whether the function's own file has changed; here all files beside it count,
those of the rooms from which compiled code is built, and this one.

This is the one file that uses what Numba keeps to itself: a dispatcher's cache.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba

_P = ParamSpec("_P")
_T = TypeVar("_T")

# Compiled code takes functions and constants from here and from its own folder: a test looks.
ROOMS = ("lie", "model", "ocp", "estimation")


def compiled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile a function when it is first called, and keep the machine code on disk.

    Floating point is strict: a flight is the same, bit for bit, in every process of a machine.
    """
    result: Callable[_P, _T]
    try:
        result = numba.njit(cache=True, error_model="numpy")(function)
        _know_all_sources(result)
        _forgive(result)
    except RuntimeError:  # neither beside the source nor in the user's folder may it write
        result = numba.njit(error_model="numpy")(function)
    return result


def _know_all_sources(dispatcher: Any) -> None:
    """Let machine code on disk be good only for the sources that it was made of."""
    folder = Path(dispatcher.py_func.__code__.co_filename).resolve().parent
    index = dispatcher._cache._cache_file
    index._source_stamp = _digest(folder), *_digests_of_all()


@functools.cache
def _digests_of_all() -> tuple[str, ...]:
    """Return the digests of what goes into every function's machine code, or how it is made."""
    here = Path(__file__).resolve()
    own = hashlib.blake2b(here.read_bytes(), digest_size=16).hexdigest()
    return own, *(_digest(here.parent / room) for room in ROOMS)


@functools.cache
def _digest(folder: Path) -> str:
    """Return a digest of the Python files of a folder."""
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(folder.glob("*.py")):
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _forgive(dispatcher: Any) -> None:
    """Let a function compile anew where its machine code on disk cannot be read.

    That of an earlier version may name a type which there is no more, and Numba asks whether it is
    of an earlier version only after reading it.
    """
    cache = dispatcher._cache
    load = cache.load_overload

    def load_overload(*arguments: Any) -> Any:
        try:
            return load(*arguments)
        except (AttributeError, ImportError):
            cache.flush()
            return None

    cache.load_overload = load_overload

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Validation of arguments of the public API.

Each function returns the argument in the type that the library uses, or raises
:class:`ArgumentError` with the argument's name, the given and the expected value. An argument of
the type is returned unchanged, so that a check costs less than a microsecond.
"""

from __future__ import annotations

import math
import operator
from numbers import Real
from types import EllipsisType
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.errors import ArgumentError

T = TypeVar("T")

LONGEST_NS = 2**62
"""Bound of stamps and times [ns], 146 years: differences of two fit into 64 bits."""

_FLOAT, _STAMP = np.dtype(np.float64), np.dtype(np.int64)
_REAL, _WHOLE = "fiu", "iu"  # kinds of NumPy's types


def array(
    given: object, name: str, *shape: int | EllipsisType, finite: bool = False
) -> NDArray[np.float64]:
    """Return numbers as an array of floats of a shape; a leading ``...`` stands for any axes.

    The array is writable and contiguous, as compiled code requires. A list of numbers is
    converted; text, complex numbers and objects are rejected.
    """
    found: Any = given
    ready = type(found) is np.ndarray and found.dtype == _FLOAT and found.flags.carray
    if not ready or not (found.shape == shape or _fits(found, shape)):
        found = _as_array(given)
        numbers = found is not None and (found.dtype.kind in _REAL or found.size == 0)
        if found is None or not numbers or not _fits(found, shape):
            raise ArgumentError(name, given, _described(shape))
        if found.dtype != _FLOAT or not found.flags.carray:
            found = np.array(found, dtype=_FLOAT, order="C")
    if finite and not np.isfinite(found).all():
        raise ArgumentError(name, given, f"finite {_described(shape)}")
    return cast(NDArray[np.float64], found)


def stamps(given: object, name: str) -> NDArray[np.int64]:
    """Return whole numbers (n,) of nanoseconds as an array."""
    found = _as_array(given)
    whole = found is not None and (found.dtype.kind in _WHOLE or found.size == 0)
    if found is None or not whole or found.ndim != 1:
        raise ArgumentError(name, given, "whole numbers (n,) of nanoseconds")
    if found.size and not -LONGEST_NS < int(found.min()) <= int(found.max()) < LONGEST_NS:
        raise ArgumentError(name, given, "nanoseconds between -2^62 and 2^62")
    if found.dtype == _STAMP and found.flags.carray:
        return found
    return np.array(found, dtype=_STAMP, order="C")


def stamp(given: object, name: str) -> int:
    """Return a whole number of nanoseconds."""
    if type(given) is not int:
        try:
            given = None if isinstance(given, bool) else operator.index(given)  # type: ignore[arg-type]
        except TypeError:
            raise ArgumentError(name, given, "a whole number of nanoseconds") from None
    if given is None or not -LONGEST_NS < given < LONGEST_NS:
        raise ArgumentError(name, given, "a whole number of nanoseconds between -2^62 and 2^62")
    return given


def number(
    given: object,
    name: str,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
) -> float:
    """Return a real number above ``above``, of at least ``least`` and below ``below``."""
    if type(given) is not float:
        if not isinstance(given, Real) or isinstance(given, bool):
            raise ArgumentError(name, given, "a number")
        try:
            given = float(given)
        except OverflowError:
            raise ArgumentError(name, given, "a finite number") from None
    if not (above < given < below and given >= least):  # NaN compares with nothing
        bounds = [f" above {above:g}"] if above > -math.inf else []
        bounds += [f" of at least {least:g}"] if least > -math.inf else []
        bounds += [f" below {below:g}"] if below < math.inf else []
        raise ArgumentError(name, given, f"a finite number{' and'.join(bounds)}")
    return given


def instance(given: object, name: str, *kinds: type[T]) -> T:
    """Return an instance of one of the types."""
    if isinstance(given, kinds):
        return given
    words = " or ".join("None" if kind is type(None) else kind.__name__ for kind in kinds)
    raise ArgumentError(name, given, words)


def _fits(found: NDArray[Any], shape: tuple[int | EllipsisType, ...]) -> bool:
    """Whether an array has a shape, with a leading ``...`` for any axes."""
    if shape[:1] != (...,):
        return found.shape == shape
    last = shape[1:]
    return len(last) <= found.ndim and found.shape[found.ndim - len(last) :] == last


def _as_array(given: object) -> NDArray[Any] | None:
    """Return the argument as an array, None if NumPy cannot convert it."""
    try:
        return np.asarray(given)
    except Exception:  # of the object's own conversion
        return None


def _described(shape: tuple[int | EllipsisType, ...]) -> str:
    """Return a shape as text."""
    if len(shape) == 1 and shape[0] is not ...:
        return f"{shape[0]} numbers"
    sizes = ", ".join("..." if size is ... else str(size) for size in shape)
    return f"numbers of shape ({sizes})"

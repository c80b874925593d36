# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The values of a recording, by kind and in recorded order."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import diagnostics

T = TypeVar("T")
Stamps = NDArray[np.int64]

_DTYPES: dict[Any, type] = {int: np.int64, float: np.float64, str: np.str_}
_WIDTHS = {"q_WB_xyzw": 4}  # other arrays are vectors of three
_STATS_TYPES = get_type_hints(TickStats)


@dataclass(frozen=True, kw_only=True, eq=False)
class Received(Generic[T]):
    """A value with the record and publish times of its message [ns]."""

    value: T
    log_time_ns: int
    publish_time_ns: int


class Log(list[Received[T]]):
    """Values of one dataclass, which has a stamp, in the order in which they were recorded."""

    def __init__(self, kind: Callable[..., T], received: Iterable[Received[T]] = ()) -> None:
        """Take the class, and existing values."""
        super().__init__(received)
        self._types = get_type_hints(kind)

    def column(self, name: str) -> NDArray[Any]:
        """Return a field of all values: numbers and texts (n,), arrays (n, k)."""
        values, kind = [getattr(each.value, name) for each in self], self._types[name]
        if kind in _DTYPES:
            return np.array(values, _DTYPES[kind])
        return np.array(values, np.float64).reshape(-1, _WIDTHS.get(name, 3))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all fields, keyed by name."""
        return {name: self.column(name) for name in self._types}

    @property
    def stamp_ns(self) -> Stamps:
        """Return the stamps (n,)."""
        return self.column("stamp_ns")

    @property
    def log_time_ns(self) -> Stamps:
        """Return the record times (n,)."""
        return np.array([each.log_time_ns for each in self], np.int64)

    @property
    def publish_time_ns(self) -> Stamps:
        """Return the publish times (n,)."""
        return np.array([each.publish_time_ns for each in self], np.int64)


def tick_stats(message: Any) -> TickStats:
    """Return the figures in a message of ``mpc/stats``.

    Figures missing in an earlier version have their default. Raises ``KeyError`` or ``ValueError``
    for a message of another package.
    """
    figures = diagnostics.stats_from_message(message)
    values = {
        field.name: _STATS_TYPES[field.name](figures[field.name])
        for field in dataclasses.fields(TickStats)
        if field.name in figures or field.default is dataclasses.MISSING
    }
    stats = TickStats(**values)
    if not (math.isfinite(stats.odom_age_ms) and math.isfinite(stats.reference_age_ms)):
        raise ValueError("an age is not finite")
    if any(abs(value) >= 2**63 for value in values.values() if isinstance(value, int)):
        raise ValueError("a whole number has more than 64 bits")
    return stats

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The values of a recording, by kind and in recorded order, with eight bytes per number.

A log grows while messages are read and is indexed like a list of :class:`Received`, whose items
are created on demand. An hour of flight as Python objects would fill the memory.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import diagnostics

T = TypeVar("T")
Stamps = NDArray[np.int64]

_TYPE_CODES: dict[Any, str] = {int: "q", float: "d"}
_WIDTHS = {"q_WB_xyzw": 4}  # other arrays are vectors of three
_STATS_TYPES = get_type_hints(TickStats)


@dataclass(frozen=True, kw_only=True, eq=False)
class Received(Generic[T]):
    """A value with the record and publish times of its message [ns]."""

    value: T
    log_time_ns: int
    publish_time_ns: int


class Log(Sequence[Received[T]]):
    """Values of one dataclass, which has a stamp, in the order in which they were recorded."""

    def __init__(self, kind: Callable[..., T], received: Iterable[Received[T]] = ()) -> None:
        """Take the class, and existing values."""
        self._kind = kind
        types = get_type_hints(kind)
        self._columns: dict[str, Any] = {
            name: [] if of is str else array(_TYPE_CODES.get(of, "d"))
            for name, of in types.items()
        }
        self._widths = {
            name: _WIDTHS.get(name, 3)
            for name, of in types.items()
            if of is not str and of not in _TYPE_CODES
        }
        self._log_times, self._publish_times = array("q"), array("q")
        for each in received:
            self.append(each)

    def append(self, received: Received[T]) -> None:
        """Add a value at the end."""
        for name, column in self._columns.items():
            field = getattr(received.value, name)
            if name in self._widths:
                column.extend(field.tolist())
            else:
                column.append(sys.intern(field) if isinstance(field, str) else field)
        self._log_times.append(received.log_time_ns)
        self._publish_times.append(received.publish_time_ns)

    def column(self, name: str) -> NDArray[Any]:
        """Return a field of all values: numbers and texts (n,), arrays (n, k)."""
        column = self._columns[name]
        values = np.array(column, dtype=np.str_ if isinstance(column, list) else column.typecode)
        return values.reshape(-1, self._widths[name]) if name in self._widths else values

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all fields, keyed by name."""
        return {name: self.column(name) for name in self._columns}

    @property
    def stamp_ns(self) -> Stamps:
        """Return the stamps (n,)."""
        return self.column("stamp_ns")

    @property
    def log_time_ns(self) -> Stamps:
        """Return the record times (n,)."""
        return np.array(self._log_times)

    @property
    def publish_time_ns(self) -> Stamps:
        """Return the publish times (n,)."""
        return np.array(self._publish_times)

    def __len__(self) -> int:
        return len(self._log_times)

    @overload
    def __getitem__(self, index: int) -> Received[T]: ...

    @overload
    def __getitem__(self, index: slice) -> list[Received[T]]: ...

    def __getitem__(self, index: int | slice) -> Received[T] | list[Received[T]]:
        place = range(len(self))[index]
        if isinstance(place, range):
            return [self[each] for each in place]
        return Received(
            value=self._kind(**{name: self._field(name, place) for name in self._columns}),
            log_time_ns=self._log_times[place],
            publish_time_ns=self._publish_times[place],
        )

    def _field(self, name: str, place: int) -> Any:
        column, width = self._columns[name], self._widths.get(name)
        return (
            column[place]
            if width is None
            else np.array(column[width * place : width * (place + 1)])
        )


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

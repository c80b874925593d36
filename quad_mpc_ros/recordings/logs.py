"""The values of a recording, by kind and in recorded order, with eight bytes per number.

A log grows while messages are read and is indexed like a list of :class:`Received`, whose items
are created on demand. An hour of flight as Python objects would fill the memory.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
import sys
from abc import abstractmethod
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Self, TypeVar, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.model.samples import CommandSample, ImuSample, OdometrySample
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import diagnostics

T = TypeVar("T")
Stamps = NDArray[np.int64]

_TYPE_CODES: dict[Any, str] = {int: "q", float: "d"}
_WIDTHS = {"q_WB_xyzw": 4}  # other arrays are vectors of three
_hints = functools.cache(get_type_hints)
_STATS_TYPES = _hints(TickStats)


@dataclass(frozen=True, kw_only=True, eq=False)
class Received(Generic[T]):
    """A value with the record and publish times of its message [ns]."""

    value: T
    log_time_ns: int
    publish_time_ns: int


class _MadeOnDemand(Sequence[T]):
    @abstractmethod
    def _made(self, place: int) -> T:
        """Return the item at an index, 0 or more."""

    @overload
    def __getitem__(self, index: int) -> T: ...

    @overload
    def __getitem__(self, index: slice) -> list[T]: ...

    def __getitem__(self, index: int | slice) -> T | list[T]:
        places = range(len(self))[index]
        return self._made(places) if isinstance(places, int) else [*map(self._made, places)]


class SampleColumns(_MadeOnDemand[T]):
    """Values of one dataclass, which has a stamp, kept field by field."""

    def __init__(self, kind: Callable[..., T]) -> None:
        self._kind = kind
        self._columns = {name: _column(name, of) for name, of in _hints(kind).items()}
        self._fields = operator.attrgetter(*self._columns)
        self._appends = [column.append for column in self._columns.values()]

    def add(self, value: T) -> None:
        """Add a value at the end."""
        for append, field in zip(self._appends, self._fields(value), strict=True):
            append(field)

    def column(self, name: str) -> NDArray[Any]:
        """Return a field of all values: numbers and texts (n,), arrays (n, k)."""
        column = self._columns[name]
        if isinstance(column, _VectorColumn):
            return column.rows
        return (
            np.array(column, dtype=np.str_) if isinstance(column, _TextColumn) else _numpy(column)
        )

    def __len__(self) -> int:
        return len(self._columns["stamp_ns"])

    def _made(self, place: int) -> T:
        return self._kind(**{name: column[place] for name, column in self._columns.items()})


class Log(_MadeOnDemand[Received[T]]):
    """Values with the times of their messages, in the order in which they were recorded."""

    kind: ClassVar[Callable[..., Any]]

    def __init__(self) -> None:
        self.values: SampleColumns[T] = SampleColumns(self.kind)
        self._log_times = array("q")
        self._publish_times = array("q")

    @classmethod
    def of(cls, received: Iterable[Received[T]]) -> Self:
        """Return a log of existing values."""
        log = cls()
        for each in received:
            log.append(each)
        return log

    def append(self, received: Received[T]) -> None:
        """Add a value at the end."""
        self.values.add(received.value)
        self._log_times.append(received.log_time_ns)
        self._publish_times.append(received.publish_time_ns)

    @property
    def stamp_ns(self) -> Stamps:
        """Return the stamps (n,)."""
        return self.values.column("stamp_ns")

    @property
    def log_time_ns(self) -> Stamps:
        """Return the record times (n,)."""
        return _numpy(self._log_times)

    @property
    def publish_time_ns(self) -> Stamps:
        """Return the publish times (n,)."""
        return _numpy(self._publish_times)

    def __len__(self) -> int:
        return len(self._log_times)

    def _made(self, place: int) -> Received[T]:
        return Received(
            value=self.values[place],
            log_time_ns=self._log_times[place],
            publish_time_ns=self._publish_times[place],
        )


class OdometryLog(Log[OdometrySample]):
    """Odometries."""

    kind = OdometrySample


class ImuLog(Log[ImuSample]):
    """Samples of an accelerometer."""

    kind = ImuSample


class CommandLog(Log[CommandSample]):
    """Commands."""

    kind = CommandSample


class StatsLog(SampleColumns[TickStats]):
    """The figures of ticks in the order in which they were recorded."""

    def __init__(self) -> None:
        super().__init__(TickStats)

    def add(self, value: TickStats) -> None:
        """Add the figures of a tick. Raises ``ValueError`` for unusable values."""
        if not (math.isfinite(value.odom_age_ms) and math.isfinite(value.reference_age_ms)):
            raise ValueError("an age is not finite")
        try:
            super().add(value)
        except OverflowError as error:
            raise ValueError(str(error)) from error

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all figures as arrays (n,) of their types, keyed by name."""
        return {name: self.column(name) for name in self._columns}


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
    return TickStats(**values)


class _TextColumn(list[str]):
    """Repeated texts, each stored once."""

    def append(self, text: str) -> None:
        super().append(sys.intern(text))


class _VectorColumn:
    """Arrays of one width."""

    def __init__(self, width: int) -> None:
        self._numbers = array("d")
        self._width = width

    def append(self, values: NDArray[Any]) -> None:
        self._numbers.extend(values.tolist())

    def __len__(self) -> int:
        return len(self._numbers) // self._width

    def __getitem__(self, place: int) -> NDArray[Any]:
        return _numpy(self._numbers[place * self._width : (place + 1) * self._width])

    @property
    def rows(self) -> NDArray[Any]:
        return _numpy(self._numbers).reshape(-1, self._width)


def _numpy(numbers: array[Any]) -> NDArray[Any]:
    return np.array(numbers, dtype=np.int64 if numbers.typecode == "q" else np.float64)


def _column(name: str, kind: Any) -> array[Any] | _TextColumn | _VectorColumn:
    if kind is str:
        return _TextColumn()
    return array(_TYPE_CODES[kind]) if kind in _TYPE_CODES else _VectorColumn(_WIDTHS.get(name, 3))

"""The values of a recording, kind by kind and in its order, at eight bytes a number.

A log grows while messages are read one by one; it is indexed like a list of :class:`Received`,
each made when it is asked for. An hour of flight as Python objects would fill the memory.
"""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Self, TypeVar, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.lie import Array
from quad_mpc_ros.messages import diagnostics
from quad_mpc_ros.model.samples import CommandSample, OdometrySample, ReferenceWindow

T = TypeVar("T")
Stamps = NDArray[np.int64]

_FIGURES = get_type_hints(TickStats)


@dataclass(frozen=True, kw_only=True, eq=False)
class Received(Generic[T]):
    """A value and when its message was recorded and published [ns]."""

    value: T
    log_time_ns: int
    publish_time_ns: int


class Rows:
    """Rows of ``width`` numbers that grow."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._numbers = array("d")

    def append(self, numbers: Iterable[float]) -> None:
        """Add a row."""
        self._numbers.extend(numbers)

    def some(self, start: int, stop: int) -> Array:
        """Return the rows from ``start`` up to ``stop`` (n, width)."""
        chosen = self._numbers[start * self._width : stop * self._width]
        return np.array(chosen, dtype=np.float64).reshape(-1, self._width)

    @property
    def all(self) -> Array:
        """Return all rows (n, width)."""
        return np.array(self._numbers, dtype=np.float64).reshape(-1, self._width)


class Log(Sequence[Received[T]]):
    """Values with the times of their messages, in the order in which they were recorded."""

    def __init__(self) -> None:
        self._stamps = array("q")
        self._log_times = array("q")
        self._publish_times = array("q")

    @classmethod
    def of(cls, received: Iterable[Received[T]]) -> Self:
        """Return a log of values that there are already."""
        log = cls()
        for each in received:
            log.add(each.value, log_time_ns=each.log_time_ns, publish_time_ns=each.publish_time_ns)
        return log

    def add(self, value: T, *, log_time_ns: int, publish_time_ns: int) -> None:
        """Add a value at the end."""
        self._stamps.append(self._keep(value))
        self._log_times.append(log_time_ns)
        self._publish_times.append(publish_time_ns)

    @property
    def stamp_ns(self) -> Stamps:
        """Return the stamps (n,)."""
        return np.array(self._stamps, dtype=np.int64)

    @property
    def log_time_ns(self) -> Stamps:
        """Return when each was recorded (n,)."""
        return np.array(self._log_times, dtype=np.int64)

    @property
    def publish_time_ns(self) -> Stamps:
        """Return when each was published (n,)."""
        return np.array(self._publish_times, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._stamps)

    @overload
    def __getitem__(self, index: int) -> Received[T]: ...

    @overload
    def __getitem__(self, index: slice) -> list[Received[T]]: ...

    def __getitem__(self, index: int | slice) -> Received[T] | list[Received[T]]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        place = range(len(self))[index]
        return Received(
            value=self._value(place, self._stamps[place]),
            log_time_ns=self._log_times[place],
            publish_time_ns=self._publish_times[place],
        )

    @abstractmethod
    def _keep(self, value: T) -> int:
        """Store all of a value but its stamp, which is returned."""

    @abstractmethod
    def _value(self, place: int, stamp_ns: int) -> T:
        """Return a value again."""


class OdometryLog(Log[OdometrySample]):
    """Odometries; ``rows`` are p_WB, q_WB_xyzw, v_WB_B, w_WB_B, (n, 13) together."""

    def __init__(self) -> None:
        super().__init__()
        self.rows = Rows(13)
        self._frames = _Words()

    def _keep(self, value: OdometrySample) -> int:
        self.rows.append(value.p_WB.tolist())
        self.rows.append(value.q_WB_xyzw.tolist())
        self.rows.append(value.v_WB_B.tolist())
        self.rows.append(value.w_WB_B.tolist())
        self._frames.append(value.frame_id)
        self._frames.append(value.child_frame_id)
        return value.stamp_ns

    def _value(self, place: int, stamp_ns: int) -> OdometrySample:
        (row,) = self.rows.some(place, place + 1)
        return OdometrySample(
            stamp_ns=stamp_ns,
            p_WB=row[0:3],
            q_WB_xyzw=row[3:7],
            v_WB_B=row[7:10],
            w_WB_B=row[10:13],
            frame_id=self._frames.words[2 * place],
            child_frame_id=self._frames.words[2 * place + 1],
        )


class CommandLog(Log[CommandSample]):
    """Commands; ``rows`` are throttle and body rates (n, 4)."""

    def __init__(self) -> None:
        super().__init__()
        self.rows = Rows(4)
        self._frames = _Words()

    def _keep(self, value: CommandSample) -> int:
        self.rows.append((value.throttle, *value.w_WB_B.tolist()))
        self._frames.append(value.frame_id)
        return value.stamp_ns

    def _value(self, place: int, stamp_ns: int) -> CommandSample:
        (row,) = self.rows.some(place, place + 1)
        return CommandSample(
            stamp_ns=stamp_ns,
            throttle=float(row[0]),
            w_WB_B=row[1:4],
            frame_id=self._frames.words[place],
        )


class WindowLog(Log[ReferenceWindow]):
    """Windows of the reference, of any number of points each."""

    def __init__(self) -> None:
        super().__init__()
        self._points = Rows(16)
        self._offsets = array("q")
        self._ends = array("q")
        self._frames = _Words()

    def _keep(self, value: ReferenceWindow) -> int:
        fields = (value.p_WB, value.q_WB_xyzw, value.v_WB_W, value.a_WB_W, value.w_WB_W)
        self._points.append(np.hstack(fields).ravel().tolist())
        self._offsets.extend(value.offset_ns.tolist())
        self._ends.append(len(self._offsets))
        self._frames.append(value.frame_id)
        return value.stamp_ns

    def _value(self, place: int, stamp_ns: int) -> ReferenceWindow:
        start, end = self._ends[place - 1] if place else 0, self._ends[place]
        points = self._points.some(start, end)
        p, q, v, a, w = (
            np.ascontiguousarray(columns)
            for columns in np.split(points, np.cumsum((3, 4, 3, 3)), axis=1)
        )
        return ReferenceWindow(
            stamp_ns=stamp_ns,
            offset_ns=np.array(self._offsets[start:end], dtype=np.int64),
            p_WB=p,
            q_WB_xyzw=q,
            v_WB_W=v,
            a_WB_W=a,
            w_WB_W=w,
            frame_id=self._frames.words[place],
        )


class StatsLog(Sequence[TickStats]):
    """The figures of ticks in the order in which they were recorded."""

    def __init__(self) -> None:
        self._columns: dict[str, array[int] | array[float] | _Words] = {
            name: _Words() if kind is str else array("q" if kind is int else "d")
            for name, kind in _FIGURES.items()
        }

    def add(self, tick: TickStats) -> None:
        """Add the figures of a tick. Raises ``ValueError`` for those that cannot be used."""
        if not (math.isfinite(tick.odom_age_ms) and math.isfinite(tick.reference_age_ms)):
            raise ValueError("an age is not finite")
        try:
            for name, column in self._columns.items():
                column.append(getattr(tick, name))
        except OverflowError as error:
            raise ValueError(str(error)) from error

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Return every figure as an array (n,) of its type, by its name."""
        return {
            name: np.array(column.words, dtype=np.str_)
            if isinstance(column, _Words)
            else np.array(column, dtype=_FIGURES[name])
            for name, column in self._columns.items()
        }

    def __len__(self) -> int:
        return len(self._column("stamp_ns"))

    @overload
    def __getitem__(self, index: int) -> TickStats: ...

    @overload
    def __getitem__(self, index: slice) -> list[TickStats]: ...

    def __getitem__(self, index: int | slice) -> TickStats | list[TickStats]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        return TickStats(**{name: self._column(name)[index] for name in self._columns})

    def _column(self, name: str) -> Sequence[Any]:
        column = self._columns[name]
        return column.words if isinstance(column, _Words) else column


def tick_stats(message: Any) -> TickStats:
    """Return the figures in a message of ``mpc/stats``.

    Figures that an earlier version did not have take their default. Raises ``KeyError`` or
    ``ValueError`` for another's message.
    """
    told = diagnostics.stats_from_message(message)
    values = {
        field.name: _FIGURES[field.name](told[field.name])
        for field in dataclasses.fields(TickStats)
        if field.name in told or field.default is dataclasses.MISSING
    }
    return TickStats(**values)


class _Words:
    """Words that repeat, each kept once."""

    def __init__(self) -> None:
        self.words: list[str] = []
        self._known: dict[str, str] = {}

    def append(self, word: str) -> None:
        self.words.append(self._known.setdefault(word, word))

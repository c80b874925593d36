"""What is known of a vehicle: the newest message of each topic, when it came, and how often.

Messages stay bytes until a picture is made: at 50 Hz decoding them all would take a whole core.
"""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import cdr, conversions
from quad_mpc_ros.messages.topics import (
    BATTERY,
    COMMAND,
    ENGAGED,
    LANDED,
    ODOMETRY,
    REFERENCE,
    STATS,
    Topic,
)
from quad_mpc_ros.recordings.logs import tick_stats

T = TypeVar("T")

WATCHED = (ODOMETRY, REFERENCE, COMMAND, STATS, ENGAGED, LANDED, BATTERY)
"""The topics of a vehicle that are looked at."""

REMEMBERED = 10.0
"""For how long [s] what was seen is remembered."""

_TRAIL = 60.0  # s
_COUNTED = 2.0  # s over which rates are counted
_MOST_COUNTED = 4096
_LOG_LINES = 5


@dataclass(frozen=True, kw_only=True)
class Arrival:
    """A message: when it came [s], its bytes, and what decodes it."""

    seconds: float
    data: bytes
    decode: Callable[[], Any]


class Sample(NamedTuple):
    """What a picture showed, at a time [s]; of an error [m] that is unknown None."""

    seconds: float
    stats: TickStats | None
    error: float | None


@dataclass(frozen=True, kw_only=True)
class NodeHealth:
    """What a node says of itself on ``/diagnostics``, and when [s]; ``level`` is 0, 1 or 2."""

    seconds: float
    level: int
    text: str
    values: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class LogLine:
    """A line of a node's log; ``level`` as in ``rcl_interfaces/Log``."""

    node: str
    level: int
    text: str


class Arrivals:
    """When messages of a topic came, and the newest of them."""

    def __init__(self) -> None:
        self.newest: Arrival | None = None
        self._times: deque[float] = deque(maxlen=_MOST_COUNTED)

    def take(self, arrival: Arrival) -> None:
        """Take a message."""
        self.newest = arrival
        self._times.append(arrival.seconds)

    def rate(self, now: float) -> float:
        """Return the messages per second lately."""
        times = list(self._times)
        recent = len(times) - bisect.bisect_right(times, now - _COUNTED)
        if recent < 2:
            return recent / _COUNTED
        return (recent - 1) / (times[-1] - times[-recent]) if times[-1] > times[-recent] else 0.0

    def age(self, now: float) -> float | None:
        """Return the age of the newest message [s]; None without one."""
        return None if self.newest is None else max(now - self.newest.seconds, 0.0)


class Vehicle:
    """One vehicle. Times are seconds of the clock by which messages come."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace
        self.topics = {topic.name: Arrivals() for topic in WATCHED}
        self.health: dict[str, NodeHealth] = {}
        self.log: deque[LogLine] = deque(maxlen=_LOG_LINES)
        self.history: deque[Sample] = deque()
        self.odometry: OdometrySample | None = None
        self.stats: TickStats | None = None
        self.error: float | None = None
        self._places: deque[tuple[float, Array]] = deque()

    def take(self, topic: Topic, arrival: Arrival) -> None:
        """Take a message of one of the topics."""
        self.topics[topic.name].take(arrival)

    def take_health(self, node: str, health: NodeHealth) -> None:
        """Take what a node of the vehicle says of itself."""
        self.health[node] = health

    @property
    def trail(self) -> Array:
        """Where it was lately (n, 3) [m], the oldest first."""
        return np.array([place for _, place in self._places]).reshape(-1, 3)

    def look(self, now: float) -> None:
        """Decode what is newest, and remember it."""
        self.odometry = self._read(ODOMETRY, _odometry)
        self.stats = self._read(STATS, lambda arrival: tick_stats(arrival.decode()))
        self.error = self._tracking_error()
        if self._places and now < self._places[-1][0]:  # a bag that begins again
            self._places.clear()
            self.history.clear()
        self.history.append(Sample(now, self.stats, self.error))
        if self.odometry is not None:
            self._places.append((now, self.odometry.p_WB))
        for kept, most in ((self.history, REMEMBERED), (self._places, _TRAIL)):
            while kept and now - kept[0][0] > most:
                kept.popleft()

    def flag(self, topic: Topic) -> bool | None:
        """Return what a topic of a ``std_msgs/Bool`` says; None without a message."""
        return self._read(topic, lambda arrival: bool(arrival.decode().data))

    @property
    def voltage(self) -> float | None:
        """The battery's [V], or None."""
        return self._read(BATTERY, lambda arrival: float(arrival.decode().voltage))

    def spread(self, values: Callable[[Sample], float | None]) -> tuple[float, float] | None:
        """Return the least and the most of something in what is remembered, or None."""
        found = [value for each in self.history if (value := values(each)) is not None]
        return (min(found), max(found)) if found else None

    def _tracking_error(self) -> float | None:
        window = self._read(REFERENCE, _reference)
        if self.odometry is None or window is None:
            return None
        try:
            place, _ = window.pose_at(self.odometry.stamp_ns)
        except (IndexError, ValueError):
            return None
        error = float(np.linalg.norm(place - self.odometry.p_WB))
        return error if np.isfinite(error) else None

    def _read(self, topic: Topic, read: Callable[[Arrival], T | None]) -> T | None:
        """Return what the newest message of a topic says; None where it cannot be used."""
        newest = self.topics[topic.name].newest
        if newest is None:
            return None
        try:
            return read(newest)
        except (BagError, KeyError, ValueError):
            return None


class Vehicles:
    """Every vehicle that was heard of, by namespace; ``only`` some if not None."""

    def __init__(self, only: Sequence[str] | None) -> None:
        self._only = None if only is None else {name.strip("/") for name in only}
        self._found: dict[str, Vehicle] = {name: Vehicle(name) for name in self._only or ()}

    def __iter__(self) -> Iterator[Vehicle]:
        return iter([vehicle for _, vehicle in sorted(self._found.items())])

    def of(self, namespace: str) -> Vehicle | None:
        """Return the vehicle of a namespace, or None if it is not to be watched."""
        name = namespace.strip("/")
        if self._only is not None and name not in self._only:
            return None
        return self._found.setdefault(name, Vehicle(name))

    def take_diagnostics(self, message: Any, *, seconds: float) -> None:
        """Take a ``diagnostic_msgs/DiagnosticArray`` of ``/diagnostics``."""
        for status in message.status:
            namespace, _, node = str(status.name).rpartition("/")
            vehicle = self._found.get(namespace.strip("/"))
            if vehicle is None or not str(status.name).startswith("/"):
                continue
            vehicle.take_health(
                node,
                NodeHealth(
                    seconds=seconds,
                    level=status.level[0] if isinstance(status.level, bytes) else status.level,
                    text=str(status.message),
                    values={str(pair.key): str(pair.value) for pair in status.values},
                ),
            )

    def take_log(self, message: Any) -> None:
        """Take a ``rcl_interfaces/Log``, whose name has dots where a node's has slashes."""
        namespace, _, node = str(message.name).rpartition(".")
        vehicle = self._found.get(namespace.replace(".", "/"))
        if vehicle is not None and node in vehicle.health:
            vehicle.log.append(LogLine(node=node, level=int(message.level), text=str(message.msg)))


def _odometry(arrival: Arrival) -> OdometrySample | None:
    found = cdr.read_odometry(arrival.data)
    found = conversions.odometry_from_message(arrival.decode()) if found is None else found
    return found if odometry_fault(found, frame_id=found.frame_id) is None else None


def _reference(arrival: Arrival) -> ReferenceWindow | None:
    found = cdr.read_reference(arrival.data)
    return conversions.reference_from_message(arrival.decode()) if found is None else found

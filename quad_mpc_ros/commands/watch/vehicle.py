"""The newest message of each topic of a vehicle, when it was received, and how often.

Messages stay bytes until a table is drawn: at 50 Hz decoding them all would take a whole core.
"""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from quad_mpc_ros.control.tick import TickStats
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
"""The topics of a vehicle that are subscribed to."""

_REMEMBERED = 10.0  # s, for counters that rise
_COUNTED = 2.0  # s over which rates are counted
_MOST_COUNTED = 4096
_LOG_LINES = 5


@dataclass(frozen=True, kw_only=True)
class NodeHealth:
    """A node's status on ``/diagnostics``, and when it was received [s]; ``level`` is 0 to 2."""

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
    """When messages of a topic were received, and what decodes the newest of them."""

    def __init__(self) -> None:
        self.newest: Callable[[], Any] | None = None
        self._times: deque[float] = deque(maxlen=_MOST_COUNTED)

    def take(self, decode: Callable[[], Any], *, seconds: float) -> None:
        """Add a message received at a time [s]; ``decode`` raises ``ValueError`` for bad bytes."""
        self.newest = decode
        self._times.append(seconds)

    def rate(self, now: float) -> float:
        """Return the messages per second lately."""
        times = list(self._times)
        recent = len(times) - bisect.bisect_right(times, now - _COUNTED)
        if recent < 2:
            return recent / _COUNTED
        return (recent - 1) / (times[-1] - times[-recent]) if times[-1] > times[-recent] else 0.0

    def age(self, now: float) -> float | None:
        """Return the age of the newest message [s]; None without one."""
        return max(now - self._times[-1], 0.0) if self._times else None


class Vehicle:
    """One vehicle. Times are seconds of the clock by which messages are received."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace
        self.topics = {topic.name: Arrivals() for topic in WATCHED}
        self.health: dict[str, NodeHealth] = {}
        self.log: deque[LogLine] = deque(maxlen=_LOG_LINES)
        self.stats: TickStats | None = None
        self.stats_age: float | None = None
        self._ticks: deque[tuple[float, TickStats]] = deque()

    def look(self, now: float) -> None:
        """Decode the newest statistics of the MPC, and remember them for a while."""
        self.stats = self.read(STATS, tick_stats)
        self.stats_age = self.topics[STATS.name].age(now)
        if self.stats is not None:
            self._ticks.append((now, self.stats))
        while self._ticks and now - self._ticks[0][0] > _REMEMBERED:
            self._ticks.popleft()

    def has_risen(self, counter: str) -> bool:
        """Whether a counter of the statistics has risen lately."""
        if self.stats is None or not self._ticks:
            return False
        return bool(getattr(self.stats, counter) > getattr(self._ticks[0][1], counter))

    def read(self, topic: Topic, convert: Callable[[Any], T | None]) -> T | None:
        """Return what the newest message of a topic says; None where it cannot be used."""
        newest = self.topics[topic.name].newest
        if newest is None:
            return None
        try:
            return convert(newest())
        except (IndexError, KeyError, ValueError):
            return None


class Vehicles:
    """Every vehicle that was found, by namespace; ``only`` some if not None."""

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
        """Add a ``diagnostic_msgs/DiagnosticArray`` of ``/diagnostics``."""
        for status in message.status:
            namespace, _, node = str(status.name).rpartition("/")
            vehicle = self._found.get(namespace.strip("/"))
            if vehicle is not None and str(status.name).startswith("/"):
                vehicle.health[node] = NodeHealth(
                    seconds=seconds,
                    level=status.level[0] if isinstance(status.level, bytes) else status.level,
                    text=str(status.message),
                    values={str(pair.key): str(pair.value) for pair in status.values},
                )

    def take_log(self, message: Any) -> None:
        """Add a ``rcl_interfaces/Log``, whose name has dots where a node's has slashes."""
        namespace, _, node = str(message.name).rpartition(".")
        vehicle = self._found.get(namespace.replace(".", "/"))
        if vehicle is not None and node in vehicle.health:
            vehicle.log.append(LogLine(node=node, level=int(message.level), text=str(message.msg)))

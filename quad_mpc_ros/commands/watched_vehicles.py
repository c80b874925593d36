"""Watching vehicles that fly now, over DDS: a table with a column for each.

Messages stay bytes until a table is printed: at 50 Hz decoding them all would take a whole core.
"""

from __future__ import annotations

import dataclasses
import functools
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from quad_mpc_ros.commands.observer import Observer, checked_namespace, subscribe
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.topics import (
    BATTERY,
    COMMAND,
    DIAGNOSTICS,
    ENGAGED,
    LANDED,
    ODOMETRY,
    REFERENCE,
    STATS,
    Topic,
)
from quad_mpc_ros.recordings.logs import tick_stats
from quad_mpc_ros.ros.messages import message_in

T = TypeVar("T")

WATCHED = (ODOMETRY, REFERENCE, COMMAND, STATS, ENGAGED, LANDED, BATTERY)
"""The topics of a vehicle that are subscribed to."""

_PERIOD = 1.0  # s, between two tables and between two searches for vehicles
_COUNTED, _MOST_COUNTED = 2.0, 4096  # s and messages over which rates are counted
_OLD, _SILENT_NODE = 1.0, 3.0  # s; nodes report once a second
_FIRST_ODOMETRY = 5.0  # s: while they start, nodes are found seconds after each other
_MISSING = "-"
_LEVELS = ("OK", "WARN", "ERROR", "STALE")
_OVER_THE_SCREEN = "\x1b[H\x1b[2J"

_FIGURES: dict[str, Callable[[TickStats], str]] = {
    "commands": lambda stats: stats.source,
    "ground": lambda stats: stats.ground,
    "latency": lambda stats: f"{stats.odom_age_ms:.1f} ms",
    "step": lambda stats: f"{1e-3 * stats.step_time_us:.2f} ms",
    "solver": lambda stats: f"{stats.solver_status}, {stats.iterations} iterations",
    "commands sent": lambda stats: str(stats.commands),
    "fallbacks": lambda stats: str(stats.fallbacks),
    "solver failures": lambda stats: str(stats.solver_failures),
    "deadline misses": lambda stats: str(stats.deadline_misses),
    "rejected inputs": lambda stats: str(stats.rejected_inputs),
    "estimate": lambda stats: f"{stats.estimate}, {stats.estimate_resets} resets",
    "thrust scale": lambda stats: f"{stats.thrust_scale:.3f}",
    "disturbance": lambda stats: (
        f"{stats.disturbance_x:z.2f} {stats.disturbance_y:z.2f} {stats.disturbance_z:z.2f} m/s^2"
    ),
    "drag": lambda stats: f"{stats.drag:.2f} 1/s",
    "rate lag": lambda stats: f"{stats.rate_time_constant_ms:.0f} ms",
    "yaw lag": lambda stats: f"{stats.yaw_time_constant_ms:.0f} ms",
    "thrust lag": lambda stats: f"{stats.thrust_time_constant_ms:.0f} ms",
}
"""The rows that show the newest tick of the MPC."""


@dataclass(frozen=True, kw_only=True)
class NodeStatus:
    """A node's status on ``/diagnostics``, received at a time [s]."""

    seconds: float
    level: str
    text: str
    values: dict[str, str]


class WatchedVehicle:
    """What was received from one vehicle. Times are seconds of one clock."""

    def __init__(self) -> None:
        self.nodes: dict[str, NodeStatus] = {}
        self._newest: dict[str, Callable[[], Any]] = {}
        self._arrivals: dict[str, deque[float]] = {
            topic.name: deque(maxlen=_MOST_COUNTED) for topic in WATCHED
        }

    def take(self, topic: Topic, decode: Callable[[], Any], *, seconds: float) -> None:
        """Add a message received at a time [s]; ``decode`` raises ``ValueError`` for bad bytes."""
        self._newest[topic.name] = decode
        self._arrivals[topic.name].append(seconds)

    def has(self, topic: Topic) -> bool:
        """Whether a message of a topic was received."""
        return topic.name in self._newest

    def cells(self, now: float) -> dict[str, str]:
        """Return the texts of the vehicle's column by the labels of the rows, at a time [s]."""
        stats = self._read(STATS, tick_stats)
        figures = {
            label: _MISSING if stats is None else self._aged(text(stats), STATS, now)
            for label, text in _FIGURES.items()
        }
        reference = self.nodes.get("reference")
        return {
            "commands": figures.pop("commands"),
            "ground": figures.pop("ground"),
            **{
                key: (reference.values.get(key) if reference is not None else "") or _MISSING
                for key in ("mode", "request")
            },
            **{topic.name: self._flag(topic) for topic in (ENGAGED, LANDED)},
            "battery": self._voltage(now),
            **self._motion(now),
            **{
                topic.name: self._arrival(topic, now)
                for topic in (ODOMETRY, REFERENCE, COMMAND, STATS)
            },
            **figures,
            **{
                f"node {name}": _with_age(node.level, now - node.seconds, _SILENT_NODE)
                for name, node in sorted(self.nodes.items())
            },
        }

    def _flag(self, topic: Topic) -> str:
        flag = self._read(topic, lambda message: bool(message.data))
        return {None: _MISSING, True: "yes", False: "no"}[flag]

    def _voltage(self, now: float) -> str:
        voltage = self._read(BATTERY, lambda message: float(message.voltage))
        return _MISSING if voltage is None else self._aged(f"{voltage:.2f} V", BATTERY, now)

    def _motion(self, now: float) -> dict[str, str]:
        odometry = self._read(ODOMETRY, conversions.odometry_from_message)
        if odometry is None:
            return dict.fromkeys(("position", "speed", "error"), _MISSING)
        x, y, z = odometry.p_WB.tolist()
        wanted = self._read(
            REFERENCE,
            lambda message: conversions.reference_from_message(message).pose_at(odometry.stamp_ns)[
                0
            ],
        )
        error = _MISSING
        if wanted is not None:
            error = f"{np.linalg.norm(wanted - odometry.p_WB):.3f} m"
        return {
            "position": self._aged(f"{x:z.2f} {y:z.2f} {z:z.2f} m", ODOMETRY, now),
            "speed": self._aged(f"{odometry.speed:.2f} m/s", ODOMETRY, now),
            "error": self._aged(error, ODOMETRY, now),
        }

    def _arrival(self, topic: Topic, now: float) -> str:
        """Return how often messages of a topic arrive, and the age of the newest."""
        times = self._arrivals[topic.name]
        if not times:
            return _MISSING
        rate = sum(each > now - _COUNTED for each in times) / _COUNTED
        return f"{rate:.0f} Hz, {now - times[-1]:.2f} s ago"

    def _aged(self, text: str, topic: Topic, now: float) -> str:
        """Return a text with the age of the message of a topic that it is from, if it is old."""
        return _with_age(text, now - self._arrivals[topic.name][-1], _OLD)

    def _read(self, topic: Topic, convert: Callable[[Any], T]) -> T | None:
        """Return what the newest message of a topic says; None if it cannot be used."""
        if not self.has(topic):
            return None
        try:
            return convert(self._newest[topic.name]())
        except (IndexError, KeyError, ValueError):
            return None


def _with_age(text: str, age: float, limit: float) -> str:
    return text if age <= limit or text == _MISSING else f"{text} ({age:.0f} s old)"


def status_text(vehicles: Mapping[str, WatchedVehicle], now: float) -> str:
    """Return the table of vehicles, by their namespaces, with the warnings of their nodes."""
    columns = {f"/{name}": vehicle.cells(now) for name, vehicle in sorted(vehicles.items())}
    labels = dict.fromkeys(label for cells in columns.values() for label in cells)
    rows = [("vehicle", *columns)]
    rows += [
        (label, *(cells.get(label, _MISSING) for cells in columns.values())) for label in labels
    ]
    warnings = [
        f"{node.level} {name.rstrip('/')}/{each}: {node.text}"
        for name, vehicle in sorted((f"/{name}", vehicle) for name, vehicle in vehicles.items())
        for each, node in sorted(vehicle.nodes.items())
        if node.level != _LEVELS[0]
    ]
    return "\n".join((*text_table(rows, align="l" * len(rows[0])), "", *warnings))


def watch_once(namespaces: Sequence[str] | None) -> bool:
    """Print one table; return whether a message of a vehicle was received."""
    with _Watcher(namespaces) as watcher:
        watcher.spin_until(watcher.has_all_odometry, time.monotonic() + _FIRST_ODOMETRY)
        if watcher.has_received:
            watcher.spin_until(lambda: False, time.monotonic() + _COUNTED)
        print(watcher.text())
        return watcher.has_received


def watch(namespaces: Sequence[str] | None) -> None:
    """Print a table each second until Ctrl-C, over the last one if this is a terminal.

    Ctrl-C is noted only: as an exception, other libraries could turn it into another one.
    """
    stopped = threading.Event()
    before = signal.signal(signal.SIGINT, lambda *_: stopped.set())
    clear = _OVER_THE_SCREEN if sys.stdout.isatty() else ""
    try:
        with _Watcher(namespaces) as watcher:
            while not stopped.is_set():
                print(f"{clear}{time.strftime('%H:%M:%S')}\n{watcher.text()}", flush=True)
                watcher.spin_until(stopped.is_set, time.monotonic() + _PERIOD)
    finally:
        signal.signal(signal.SIGINT, before)


class _Watcher(Observer):
    """A node that subscribes to what is watched of each vehicle that it finds."""

    def __init__(self, namespaces: Sequence[str] | None) -> None:
        super().__init__("quad_mpc_watch")
        self._only = None if namespaces is None else list(map(checked_namespace, namespaces))
        self._vehicles: dict[str, WatchedVehicle] = {}
        self.has_received = False
        """Whether any message of a vehicle was received."""

    def __enter__(self) -> _Watcher:
        super().__enter__()
        for name in self._only or ():
            self._add(name)
        subscribe(self.node, DIAGNOSTICS, self._on_diagnostics)
        self._search()
        self.node.create_timer(_PERIOD, self._search)
        return self

    def has_all_odometry(self) -> bool:
        """Whether odometry of each vehicle was received, of one at least."""
        vehicles = self._vehicles.values()
        return bool(vehicles) and all(vehicle.has(ODOMETRY) for vehicle in vehicles)

    def text(self) -> str:
        """Return the table, or that there are no vehicles."""
        if not self._vehicles:
            return f"no node publishes {STATS.name} in this ROS domain yet; Ctrl-C ends"
        return status_text(self._vehicles, time.monotonic())

    def _search(self) -> None:
        for name, types in self.node.get_topic_names_and_types():
            if name.endswith(f"/{STATS.name}") and STATS.type_name in types:
                namespace = name.removesuffix(STATS.name).strip("/")
                if self._only is None and namespace not in self._vehicles:
                    self._add(namespace)

    def _add(self, namespace: str) -> None:
        """Subscribe to the topics of a vehicle, as bytes."""
        vehicle = self._vehicles[namespace] = WatchedVehicle()
        prefix = f"/{namespace}" if namespace else ""
        for topic in WATCHED:
            named = dataclasses.replace(topic, name=f"{prefix}/{topic.name}")
            subscribe(self.node, named, functools.partial(self._take, vehicle, topic), raw=True)

    def _take(self, vehicle: WatchedVehicle, topic: Topic, data: bytes) -> None:
        self.has_received = True
        decode = functools.partial(message_in, topic, data)
        vehicle.take(topic, decode, seconds=time.monotonic())

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            namespace, _, node = status.name.rpartition("/")
            vehicle = self._vehicles.get(namespace.strip("/"))
            if vehicle is not None and status.name.startswith("/"):
                vehicle.nodes[node] = NodeStatus(
                    seconds=time.monotonic(),
                    level=_LEVELS[status.level[0]],
                    text=status.message,
                    values={pair.key: pair.value for pair in status.values},
                )

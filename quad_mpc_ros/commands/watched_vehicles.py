"""Watching vehicles that fly now, over DDS: a table with a column for each.

The figures are those that the nodes report on ``/diagnostics`` once a second. Odometry and
reference stay bytes until a table is printed: at 50 Hz decoding them all would take a whole core.
"""

from __future__ import annotations

import dataclasses
import functools
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from quad_mpc_ros.commands.observer import Observer, checked_namespace, subscribe
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.messages.topics import DIAGNOSTICS, ODOMETRY, REFERENCE, Topic
from quad_mpc_ros.ros.messages import odometry_in, reference_in

T = TypeVar("T")

_MPC = "mpc"
_TABLE_COLUMNS = (
    *((_MPC, key) for key in ("source", "ground", "engaged")),
    *(("reference", key) for key in ("mode", "request")),
    *((_MPC, key) for key in ("odom_age_ms", "reference_age_ms", "step_time_us")),
    *((_MPC, key) for key in ("solver_status", "iterations", "commands", "fallbacks")),
    *((_MPC, key) for key in ("solver_failures", "deadline_misses", "rejected_inputs")),
    *((_MPC, key) for key in ("estimate", "estimate_resets", "thrust_scale", "drag")),
    *((_MPC, f"disturbance_{axis}") for axis in "xyz"),
    *((_MPC, f"{lag}_time_constant_ms") for lag in ("rate", "yaw", "thrust")),
)
"""Node and key of each row of figures, as in docs/reference/diagnostics.md."""

_TABLE_PERIOD = 1.0  # s, between two tables
_REPORT_TIMEOUT = 3.0  # s; nodes report once a second
_STARTUP_TIME = 5.0  # s: while they start, nodes are found seconds after each other
_MISSING = "-"
_LEVELS = ("OK", "WARN", "ERROR", "STALE")
_CLEAR_SCREEN = "\x1b[H\x1b[2J"


@dataclass(frozen=True, kw_only=True)
class NodeStatus:
    """A node's status on ``/diagnostics``, received at a time [s]."""

    seconds: float
    level: str
    text: str
    values: dict[str, str]


@dataclass
class WatchedVehicle:
    """The newest status of each node of a vehicle, and messages with the time of their arrival."""

    nodes: dict[str, NodeStatus] = field(default_factory=dict)
    messages: dict[str, tuple[bytes, float]] = field(default_factory=dict)

    def cells(self, now: float) -> dict[str, str]:
        """Return the texts of the vehicle's column by the labels of the rows, at a time [s]."""
        return {
            **self._motion(now),
            **{key: self._figure(node, key, now) for node, key in _TABLE_COLUMNS},
            **{
                f"node {name}": _with_age(node.level, now - node.seconds)
                for name, node in sorted(self.nodes.items())
            },
        }

    def _figure(self, node: str, key: str, now: float) -> str:
        status = self.nodes.get(node)
        if status is None or not status.values.get(key):
            return _MISSING
        return _with_age(_rounded(status.values[key]), now - status.seconds)

    def _motion(self, now: float) -> dict[str, str]:
        odometry = self._read(ODOMETRY, odometry_in)
        if odometry is None:
            return {"position": _MISSING, "error": _MISSING}
        age = now - self.messages[ODOMETRY.name][1]
        window, error = self._read(REFERENCE, reference_in), _MISSING
        if window is not None:
            wanted = window.pose_at(odometry.stamp_ns)[0]
            error = _with_age(f"{np.linalg.norm(wanted - odometry.p_WB):.3f} m", age)
        x, y, z = odometry.p_WB.tolist()
        return {"position": _with_age(f"{x:z.2f} {y:z.2f} {z:z.2f} m", age), "error": error}

    def _read(self, topic: Topic, convert: Callable[[bytes], T]) -> T | None:
        """Return the newest message of a topic; None if there is none that can be used."""
        try:
            return convert(self.messages[topic.name][0])
        except (KeyError, ValueError):
            return None


def _rounded(text: str) -> str:
    """Return a number with the digits that can be read while it changes."""
    try:
        return f"{float(text):.4g}" if "." in text else text
    except ValueError:
        return text


def _with_age(text: str, age: float) -> str:
    return text if age <= _REPORT_TIMEOUT else f"{text} ({age:.0f} s old)"


def status_text(vehicles: Mapping[str, WatchedVehicle], now: float) -> str:
    """Return the table of vehicles, by their namespaces, with the warnings of their nodes."""
    columns = {f"/{name}": vehicle.cells(now) for name, vehicle in sorted(vehicles.items())}
    labels = dict.fromkeys(label for cells in columns.values() for label in cells)
    rows = [("vehicle", *columns)]
    rows += [
        (label, *(cells.get(label, _MISSING) for cells in columns.values())) for label in labels
    ]
    warnings = [
        f"{node.level} /{name}{'/' if name else ''}{each}: {node.text}"
        for name, vehicle in sorted(vehicles.items())
        for each, node in sorted(vehicle.nodes.items())
        if node.level != _LEVELS[0]
    ]
    return "\n".join((*text_table(rows, align="l" * len(rows[0])), "", *warnings))


def watch_once(namespaces: Sequence[str] | None) -> bool:
    """Print one table; return whether an MPC has reported."""
    with _Watcher(namespaces) as watcher:
        watcher.spin_until(watcher.has_all, time.monotonic() + _STARTUP_TIME)
        print(watcher.text())
        return watcher.has_reports()


def watch(namespaces: Sequence[str] | None) -> None:
    """Print a table each second until Ctrl-C, over the last one if this is a terminal.

    Ctrl-C is noted only: as an exception, other libraries could turn it into another one.
    """
    stopped = threading.Event()
    before = signal.signal(signal.SIGINT, lambda *_: stopped.set())
    clear = _CLEAR_SCREEN if sys.stdout.isatty() else ""
    try:
        with _Watcher(namespaces) as watcher:
            while not stopped.is_set():
                print(f"{clear}{time.strftime('%H:%M:%S')}\n{watcher.text()}", flush=True)
                watcher.spin_until(stopped.is_set, time.monotonic() + _TABLE_PERIOD)
    finally:
        signal.signal(signal.SIGINT, before)


class _Watcher(Observer):
    """A node that receives the reports of all vehicles, or of those in some namespaces."""

    def __init__(self, namespaces: Sequence[str] | None) -> None:
        super().__init__("quad_mpc_watch")
        self._only = None if namespaces is None else list(map(checked_namespace, namespaces))
        self._vehicles: dict[str, WatchedVehicle] = {}

    def __enter__(self) -> _Watcher:
        super().__enter__()
        subscribe(self.node, DIAGNOSTICS, self._on_diagnostics)
        for namespace in self._only or ():
            self._add(namespace)
        return self

    def has_reports(self) -> bool:
        """Whether the MPC of a vehicle has reported."""
        return any(_MPC in vehicle.nodes for vehicle in self._vehicles.values())

    def has_all(self) -> bool:
        """Whether MPC, reference and odometry of each vehicle were received, of one at least."""
        return self.has_reports() and all(
            {_MPC, "reference"} <= vehicle.nodes.keys() and ODOMETRY.name in vehicle.messages
            for vehicle in self._vehicles.values()
        )

    def text(self) -> str:
        """Return the table, or that there are no vehicles."""
        if not self._vehicles:
            return "no MPC reports on /diagnostics in this ROS domain yet; Ctrl-C ends"
        return status_text(self._vehicles, time.monotonic())

    def _add(self, namespace: str) -> None:
        vehicle = self._vehicles[namespace] = WatchedVehicle()
        prefix = f"/{namespace}" if namespace else ""
        for topic in (ODOMETRY, REFERENCE):
            named = dataclasses.replace(topic, name=f"{prefix}/{topic.name}")
            take = functools.partial(_take, vehicle, topic.name)
            subscribe(self.node, named, take, raw=True)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            space, slash, node = status.name.rpartition("/")
            namespace = space.strip("/")
            if node == _MPC and slash and self._only is None and namespace not in self._vehicles:
                self._add(namespace)
            if namespace in self._vehicles and slash:
                self._vehicles[namespace].nodes[node] = NodeStatus(
                    seconds=time.monotonic(),
                    level=_LEVELS[status.level[0]],
                    text=status.message,
                    values={pair.key: pair.value for pair in status.values},
                )


def _take(vehicle: WatchedVehicle, name: str, data: bytes) -> None:
    vehicle.messages[name] = (data, time.monotonic())

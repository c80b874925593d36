# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Status of flying vehicles over DDS: a table with a column for each vehicle.

Most values are from ``/diagnostics``, where the nodes report once a second. Odometry and reference
are decoded only when a table is printed, because decoding every message takes a whole core.
"""

from __future__ import annotations

import dataclasses
import functools
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from quad_mpc_ros.commands.observer import Observer, checked_namespace, subscribe
from quad_mpc_ros.commands.progress import interrupts
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
"""Node and key of each row, as in docs/reference/diagnostics.md."""

_TABLE_PERIOD = 1.0  # s, between two tables
_REPORT_TIMEOUT = 3.0  # s; nodes report once a second
_STARTUP_TIME = 5.0  # s, because nodes may be discovered seconds after each other
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

    def level_at(self, now: float) -> str:
        """Return the level, with its age if the node has stopped reporting at a time [s]."""
        age = now - self.seconds
        return self.level if age <= _REPORT_TIMEOUT else f"{self.level} ({age:.0f} s old)"


@dataclass
class WatchedVehicle:
    """Newest status of each node of a vehicle, and newest message of each topic."""

    nodes: dict[str, NodeStatus] = field(default_factory=dict)
    messages: dict[str, bytes] = field(default_factory=dict)

    def cells(self, now: float) -> dict[str, str]:
        """Return the texts of the vehicle's column, keyed by row label, at a time [s]."""
        return {
            **self._motion(),
            **{key: self._value(node, key) for node, key in _TABLE_COLUMNS},
            **{f"node {name}": node.level_at(now) for name, node in sorted(self.nodes.items())},
        }

    def _value(self, node: str, key: str) -> str:
        status = self.nodes.get(node)
        return _MISSING if status is None else _rounded(status.values.get(key) or _MISSING)

    def _motion(self) -> dict[str, str]:
        odometry = self._read(ODOMETRY, odometry_in)
        if odometry is None:
            return {"position": _MISSING, "error": _MISSING}
        window, error = self._read(REFERENCE, reference_in), _MISSING
        if window is not None:
            wanted = window.pose_at(odometry.stamp_ns)[0]
            error = f"{np.linalg.norm(wanted - odometry.p_WB):.3f} m"
        x, y, z = odometry.p_WB.tolist()
        return {"position": f"{x:z.2f} {y:z.2f} {z:z.2f} m", "error": error}

    def _read(self, topic: Topic, convert: Callable[[bytes], T]) -> T | None:
        """Return the newest message of a topic; None without a valid one."""
        try:
            return convert(self.messages[topic.name])
        except (KeyError, ValueError):
            return None


def _rounded(text: str) -> str:
    """Return a number with four digits; other texts are unchanged."""
    try:
        return f"{float(text):.4g}" if "." in text else text
    except ValueError:
        return text


def status_text(vehicles: Mapping[str, WatchedVehicle], now: float) -> str:
    """Return the table of vehicles, keyed by namespace, with the warnings of their nodes."""
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
    """Print a table each second until Ctrl-C; in a terminal it replaces the last table."""
    clear = _CLEAR_SCREEN if sys.stdout.isatty() else ""
    with interrupts() as stopped, _Watcher(namespaces) as watcher:
        while not stopped.is_set():
            print(f"{clear}{time.strftime('%H:%M:%S')}\n{watcher.text()}", flush=True)
            watcher.spin_until(stopped.is_set, time.monotonic() + _TABLE_PERIOD)


class _Watcher(Observer):
    """A node that receives the reports of all vehicles, or of some namespaces."""

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
        """Whether MPC, reference and odometry of all vehicles were received, at least one."""
        return self.has_reports() and all(
            {_MPC, "reference"} <= vehicle.nodes.keys() and ODOMETRY.name in vehicle.messages
            for vehicle in self._vehicles.values()
        )

    def text(self) -> str:
        """Return the table, or a note that there are no vehicles."""
        if not self._vehicles:
            return "no MPC reports on /diagnostics in this ROS domain yet; stop with Ctrl-C"
        return status_text(self._vehicles, time.monotonic())

    def _add(self, namespace: str) -> None:
        vehicle = self._vehicles[namespace] = WatchedVehicle()
        prefix = f"/{namespace}" if namespace else ""
        for topic in (ODOMETRY, REFERENCE):
            named = dataclasses.replace(topic, name=f"{prefix}/{topic.name}")
            take = functools.partial(vehicle.messages.__setitem__, topic.name)
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

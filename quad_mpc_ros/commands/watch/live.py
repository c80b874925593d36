"""Watching vehicles that fly now, over DDS."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any

from quad_mpc_ros.commands.observer import Observer, subscribe
from quad_mpc_ros.commands.watch.screen import LONGEST_WAIT, Screen
from quad_mpc_ros.commands.watch.vehicle import WATCHED, Arrival, Vehicle, Vehicles
from quad_mpc_ros.commands.watch.view import looked_at
from quad_mpc_ros.messages.topics import DIAGNOSTICS, ODOMETRY, STATS, Topic
from quad_mpc_ros.ros.messages import decoded

_ROSOUT = Topic(name="/rosout", type_name="rcl_interfaces/msg/Log", reliable=True, depth=50)
_SEARCH_PERIOD = 1.0  # s between looks for new vehicles
_ONCE_WAITS, _ONCE_COUNTS = 5.0, 2.5  # s: for odometry of each, and then to count rates


def watch_live(screen: Screen, *, namespaces: Sequence[str] | None, interval: float) -> bool:
    """Show vehicles until interrupted, or once; return whether anything was heard of one."""
    vehicles = Vehicles(namespaces)
    with screen, _Watcher(vehicles) as watcher:
        if screen.once:
            # Of what starts, or on a busy machine, one node is found seconds after another.
            watcher.wait(_ONCE_WAITS, until=lambda: watcher.hears_all or screen.stopped)
            watcher.wait(_ONCE_COUNTS if watcher.hears else 0.0, until=lambda: screen.stopped)
            _show(vehicles, screen)
            return watcher.hears
        while not screen.stopped:
            _show(vehicles, screen)
            watcher.wait(interval, until=lambda: screen.stopped)
    return True


def _show(vehicles: Vehicles, screen: Screen) -> None:
    views = looked_at(vehicles, time.monotonic())
    if views:
        title = time.strftime("%H:%M:%S")
    else:
        title = f"nobody publishes {STATS.name} in this ROS domain yet; Ctrl-C ends"
    screen.show(views, title=title)


class _Watcher(Observer):
    """A node that subscribes to what is watched of each vehicle that it finds."""

    def __init__(self, vehicles: Vehicles) -> None:
        super().__init__("quad_mpc_watch")
        self._vehicles = vehicles
        self._subscribed: set[str] = set()
        self._searched = 0.0
        self.hears = False
        """Whether anything came."""

    @property
    def hears_all(self) -> bool:
        """Whether odometry of each vehicle has come, of one at least."""
        newest = [vehicle.topics[ODOMETRY.name].newest for vehicle in self._vehicles]
        return len(newest) > 0 and None not in newest

    def __enter__(self) -> _Watcher:
        super().__enter__()
        for vehicle in self._vehicles:
            self._subscribe(vehicle)
        subscribe(self.node, DIAGNOSTICS, self._on_diagnostics)
        subscribe(self.node, _ROSOUT, self._vehicles.take_log)
        return self

    def wait(self, seconds: float, *, until: Callable[[], bool]) -> None:
        """Take what comes for so long, or until something is true."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0 and not until():
            if time.monotonic() - self._searched > _SEARCH_PERIOD:
                self._search()
            self.executor.spin_once(timeout_sec=min(left, LONGEST_WAIT))

    def _search(self) -> None:
        self._searched = time.monotonic()
        for name, types in self.node.get_topic_names_and_types():
            if name.endswith(f"/{STATS.name}") and STATS.type_name in types:
                vehicle = self._vehicles.of(name.removesuffix(STATS.name))
                if vehicle is not None:
                    self._subscribe(vehicle)

    def _subscribe(self, vehicle: Vehicle) -> None:
        """Subscribe to the topics of a vehicle, once; as bytes."""
        if vehicle.namespace in self._subscribed:
            return
        self._subscribed.add(vehicle.namespace)
        prefix = f"/{vehicle.namespace}" if vehicle.namespace else ""
        for topic in WATCHED:
            named = dataclasses.replace(topic, name=f"{prefix}/{topic.name}")
            take = functools.partial(self._take, vehicle, topic)
            subscribe(self.node, named, take, raw=True)

    def _take(self, vehicle: Vehicle, topic: Topic, data: bytes) -> None:
        self.hears = True
        decode = functools.partial(_decoded, topic, data)
        vehicle.take(topic, Arrival(seconds=time.monotonic(), data=data, decode=decode))

    def _on_diagnostics(self, message: Any) -> None:
        self._vehicles.take_diagnostics(message, seconds=time.monotonic())


def _decoded(topic: Topic, data: bytes) -> Any:
    """Return a message. Raises ``ValueError`` for bytes that are none."""
    try:
        return decoded(topic, data)
    except Exception as error:  # whatever rclpy has for it
        raise ValueError(f"bytes are no {topic.type_name}: {error}") from error

"""Watching vehicles that fly now, over DDS."""

from __future__ import annotations

import dataclasses
import functools
import signal
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from quad_mpc_ros.commands.observer import Observer, subscribe
from quad_mpc_ros.commands.watch.screen import Screen
from quad_mpc_ros.commands.watch.vehicle import WATCHED, Vehicle, Vehicles
from quad_mpc_ros.commands.watch.view import viewed
from quad_mpc_ros.messages.topics import DIAGNOSTICS, ODOMETRY, STATS, Topic
from quad_mpc_ros.ros.messages import message_in

_ROSOUT = Topic(name="/rosout", type_name="rcl_interfaces/msg/Log", reliable=True, depth=50)
_SEARCH_PERIOD = 1.0  # s between looks for new vehicles
_ONCE_WAITS, _ONCE_COUNTS = 5.0, 2.5  # s: twice for messages of each, then to count rates


def watch_once(namespaces: Sequence[str] | None) -> bool:
    """Print one table; return whether a message of a vehicle was received."""
    vehicles = Vehicles(namespaces)
    with _Watcher(vehicles) as watcher:
        # While they start, or on a busy machine, nodes are found seconds after each other.
        watcher.wait(_ONCE_WAITS, until=lambda: watcher.has_seen_all)
        if watcher.has_received:
            watcher.wait(_ONCE_WAITS, until=lambda: watcher.has_seen_all)
            watcher.wait(_ONCE_COUNTS)
        with Screen(whole_terminal=False) as screen:
            _show(vehicles, screen)
        return watcher.has_received


def watch_live(screen: Screen, *, namespaces: Sequence[str] | None, interval: float) -> None:
    """Show vehicles, each ``interval`` [s], until Ctrl-C.

    Ctrl-C is noted only: as an exception, other libraries could turn it into another one.
    """
    vehicles, stopped = Vehicles(namespaces), threading.Event()
    before = signal.signal(signal.SIGINT, lambda *_: stopped.set())
    try:
        with _Watcher(vehicles) as watcher:
            while not stopped.is_set():
                _show(vehicles, screen)
                watcher.wait(interval, until=stopped.is_set)
    finally:
        signal.signal(signal.SIGINT, before)


def _show(vehicles: Vehicles, screen: Screen) -> None:
    now = time.monotonic()
    views = []
    for vehicle in vehicles:
        vehicle.look(now)
        views.append(viewed(vehicle, now))
    nobody = f"nobody publishes {STATS.name} in this ROS domain yet; Ctrl-C ends"
    screen.show(views, title=time.strftime("%H:%M:%S") if views else nobody)


class _Watcher(Observer):
    """A node that subscribes to what is watched of each vehicle that it finds."""

    def __init__(self, vehicles: Vehicles) -> None:
        super().__init__("quad_mpc_watch")
        self._vehicles = vehicles
        self._subscribed: set[str] = set()
        self._searched = 0.0
        self.has_received = False
        """Whether any message of a vehicle was received."""

    @property
    def has_seen_all(self) -> bool:
        """Whether odometry and statistics of each vehicle were received, of one at least."""
        needed = (ODOMETRY.name, STATS.name)
        newest = [vehicle.topics[name].newest for vehicle in self._vehicles for name in needed]
        return len(newest) > 0 and None not in newest

    def __enter__(self) -> _Watcher:
        super().__enter__()
        for vehicle in self._vehicles:
            self._subscribe(vehicle)
        subscribe(self.node, DIAGNOSTICS, self._on_diagnostics)
        subscribe(self.node, _ROSOUT, self._vehicles.take_log)
        return self

    def wait(self, seconds: float, *, until: Callable[[], bool] = lambda: False) -> None:
        """Receive messages for so long, or until something is true."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not until():
            self._search()
            self.spin_until(until, min(deadline, self._searched + _SEARCH_PERIOD))

    def _search(self) -> None:
        if time.monotonic() - self._searched < _SEARCH_PERIOD:
            return
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
        self.has_received = True
        decode = functools.partial(message_in, topic, data)
        vehicle.topics[topic.name].take(decode, seconds=time.monotonic())

    def _on_diagnostics(self, message: Any) -> None:
        self._vehicles.take_diagnostics(message, seconds=time.monotonic())

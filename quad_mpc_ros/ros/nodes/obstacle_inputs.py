# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Obstacle inputs of the MPC node: clouds, markers, transforms, neighbours."""

from __future__ import annotations

import functools
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages import topics
from quad_mpc_ros.messages.obstacle_messages import (
    markers_from_message,
    path_from_message,
    transforms_from_message,
)
from quad_mpc_ros.messages.point_cloud import point_cloud_from_message
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.lifecycle import ManagedNode
from quad_mpc_ros.ros.messages import message_class, message_in, odometry_in

if TYPE_CHECKING:  # imported only with obstacles
    from quad_mpc_ros.extras.obstacles.local_map import LocalMapProvider
    from quad_mpc_ros.extras.obstacles.world import ObstacleWorld

_CLOUD_TIMEOUT = 1.0  # s without a cloud, after the first


class ObstacleInputs:
    """Passes received obstacle messages to a world and counts rejected ones.

    A separate thread reads the newest cloud and builds the local map, so that no control step
    waits. In lockstep all messages wait for the next odometry, so that a flight is repeatable.
    """

    def __init__(
        self,
        node: ManagedNode[Any],
        world: ObstacleWorld,
        surroundings: LocalMapProvider,
        *,
        lockstep: bool,
    ) -> None:
        self._node, self._world, self._lockstep = node, world, lockstep
        self._surroundings = surroundings
        self._waiting: list[Callable[[], None]] = []
        self._counts = {"clouds": 0, "markers": 0, "plans": 0, "refused": 0}
        self._newest: deque[bytes] = deque(maxlen=1)
        self._refusals: deque[str] = deque(maxlen=10)
        self._condition = threading.Condition()
        self._closed = self._map_is_due = False
        self._thread: threading.Thread | None = None
        if not lockstep:
            surroundings.wake = self._wake
            self._thread = threading.Thread(target=self._read_clouds, name="clouds", daemon=True)
            self._thread.start()
        self._subscribe()

    def close(self) -> None:
        """Stop the thread."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        if self._thread is not None:
            self._thread.join()

    def receive_odometry(self, odometry: OdometrySample) -> None:
        """Pass on the messages that waited for this odometry, then the odometry."""
        waiting, self._waiting = self._waiting, []
        for receive in waiting:
            receive()
        self._world.receive_odometry(odometry)

    def take_warnings(self) -> list[str]:
        """Return the rejections since the last call."""
        return [self._refusals.popleft() for _ in range(len(self._refusals))]

    def values(self, stamp_ns: int) -> list[tuple[str, str]]:
        """Return counts and ages for diagnostics."""
        counts = [(f"obstacles.{name}", str(count)) for name, count in self._counts.items()]
        received = len(self._world.plans([stamp_ns]).age)
        return [
            *counts,
            ("obstacles.silence_s", f"{self._world.silence(stamp_ns):.2f}"),
            ("obstacles.neighbours", f"{received} of {len(self._world.neighbours)}"),
        ]

    def fault(self, stamp_ns: int) -> str:
        """Return an error if clouds are missing, or an empty string."""
        silence = self._world.silence(stamp_ns)
        if silence <= _CLOUD_TIMEOUT:
            return ""
        return f"no usable cloud on {topics.OBSTACLES.name} for {silence:.1f} s"

    def _subscribe(self) -> None:
        node, world = self._node, self._world

        def subscribe(topic: Topic, receive: Callable[[bytes], None]) -> None:
            callback = self._postponed(receive) if self._lockstep else receive
            node.managed_subscription(topic, callback, raw=True, expected=False)

        subscribe(topics.OBSTACLES, self._on_cloud)
        markers = _converted(topics.OBSTACLE_MARKERS, markers_from_message, world.receive_markers)
        subscribe(topics.OBSTACLE_MARKERS, self._counted("markers", markers))
        transforms = _converted(topics.TF, transforms_from_message, world.receive_transforms)
        for topic in (topics.TF, topics.TF_STATIC):
            try:
                message_class(topic.type_name)
            except ImportError:
                node.get_logger().info(
                    "tf2_msgs is not installed: clouds and markers must use the odometry's frames"
                )
                break
            subscribe(topic, self._counted(None, transforms))
        for name in world.neighbours:
            of_it, receive = (
                f"/{name.strip('/')}",
                functools.partial(world.receive_neighbour, name),
            )
            plan = _converted(topics.PREDICTED_PATH, path_from_message, receive)
            subscribe(_named(topics.PREDICTED_PATH, of_it), self._counted("plans", plan))
            state = self._counted(None, functools.partial(self._on_neighbour, name))
            subscribe(_named(topics.ODOMETRY, of_it), state)

    def _counted(
        self, counted: str | None, receive: Callable[[bytes], None]
    ) -> Callable[[bytes], None]:
        """Return a callback that counts messages and records rejections."""

        def guarded(data: bytes) -> None:
            result = counted
            try:
                receive(data)
            except ValueError as error:
                result = "refused"
                self._refusals.append(f"refused: {error}")
            if result is not None:
                with self._condition:  # both threads count
                    self._counts[result] += 1

        return guarded

    def _postponed(self, receive: Callable[[bytes], None]) -> Callable[[bytes], None]:
        """Return a callback that keeps messages until the next odometry."""
        return lambda data: self._waiting.append(functools.partial(receive, data))

    def _on_cloud(self, data: bytes) -> None:
        if self._thread is None:
            self._read_cloud(data)
            return
        with self._condition:
            self._newest.append(data)
            self._condition.notify()

    def _read_cloud(self, data: bytes) -> None:
        receive = self._world.receive_cloud
        clouds = _converted(topics.OBSTACLES, point_cloud_from_message, receive)
        self._counted("clouds", clouds)(data)

    def _wake(self) -> None:
        with self._condition:
            self._map_is_due = True
            self._condition.notify()

    def _read_clouds(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._closed or self._newest or self._map_is_due)
                if self._closed:
                    return
                self._map_is_due = False
                data = self._newest.pop() if self._newest else None
            if data is not None:
                self._read_cloud(data)
            self._surroundings.update_map()

    def _on_neighbour(self, name: str, data: bytes) -> None:
        self._world.receive_neighbour(name, odometry_in(data))


def _converted(
    topic: Topic, convert: Callable[[Any], Any], receive: Callable[[Any], None]
) -> Callable[[bytes], None]:
    """Return a callback that passes on the converted messages of a topic."""
    return lambda data: receive(convert(message_in(topic, data)))


def _named(topic: Topic, space: str) -> Topic:
    return replace(topic, name=f"{space}/{topic.name}", single_source=False, optional=True)

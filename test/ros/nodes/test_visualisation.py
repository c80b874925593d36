# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The visualisation node beside a controller that speaks over DDS."""

from __future__ import annotations

import importlib.util
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.messages import cdr, conversions
from quad_mpc_ros.messages.corridor import written_corridor

Start = Callable[..., "subprocess.Popen[bytes]"]


class Flight:
    """Odometry and plan of a vehicle that moves east at 1 m/s, a step at a time."""

    def __init__(self, peer: Any) -> None:
        self._peer, self._ticks = peer, 0
        node = peer.node
        self._odometry = node.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self._plan = node.create_publisher(
            PathMessage, "mpc/predicted_path", qos_profile_sensor_data
        )
        self.text_of: list[MarkerArray] = []
        node.create_subscription(MarkerArray, "visualisation/markers", self.text_of.append, 10)

    def await_node(self) -> None:
        publishers = (self._odometry, self._plan)
        assert self._peer.wait(
            lambda: (
                all(publisher.get_subscription_count() for publisher in publishers)
                and self._peer.node.count_publishers("visualisation/markers")
            )
        )
        # Whether the node has found this subscription is seen only when it shows something.
        assert self._peer.wait(lambda: self.tick() or self.text_of)
        self._peer.spin(0.3)
        self.text_of.clear()

    def tick(self, **position: float) -> None:
        self._ticks += 1
        odometry = Odometry()
        stamp_ns = self._ticks * 20_000_000
        conversions.fill_time(odometry.header.stamp, stamp_ns)
        odometry.header.frame_id, odometry.child_frame_id = "odom", "base_link"
        odometry.pose.pose.position.x = position.get("x", 0.02 * self._ticks)
        odometry.pose.pose.orientation.w = 1.0
        plan = cdr.written_path(
            stamp_ns=stamp_ns,
            step_ns=50_000_000,
            frame_id="odom",
            p_WB=np.outer(np.arange(11.0), [0.05, 0.0, 0.0]),
            q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (11, 1)),
        )
        self._plan.publish(plan)
        self._odometry.publish(odometry)
        self._peer.spin(0.02)


FENCE = ("-p", "fence.minimum:=[-1.0, -1.0, 0.0]", "-p", "fence.maximum:=[9.0, 1.0, 3.0]")


def test_the_fence_is_shown_at_the_publish_rate(start: Start, peer: Any, tmp_path: Path) -> None:
    flight = Flight(peer)
    start("visualisation", *FENCE)
    flight.await_node()
    started = time.monotonic()
    for _ in range(50):
        flight.tick()
    elapsed = time.monotonic() - started
    found = {marker.ns: marker for array in flight.text_of for marker in array.markers}
    assert found.keys() == {"fence"}
    # At 25 Hz at most, of what came at 50 Hz, and the one before that was on its way.
    assert 5 < len(flight.text_of) <= 25.0 * elapsed + 2
    installed = importlib.util.find_spec("tf2_msgs") is not None
    log = (tmp_path / "visualisation.log").read_text()
    assert ("no transform is broadcast" in log) != installed


def test_the_corridor_is_shown(start: Start, peer: Any) -> None:
    """The plan ends at x = 0.5 m, and half-spaces at 1 m and 2 m hold it; the nearer one cuts."""
    publisher = peer.node.create_publisher(PointCloud2, "mpc/corridor", qos_profile_sensor_data)
    normals, offsets = np.zeros((10, 2, 3)), np.tile([1.0, 2.0], (10, 1))
    normals[..., 0] = 1.0
    corridor = Corridor(stamp_ns=1, step=0.05, normals=normals, offsets=offsets)
    flight = Flight(peer)
    start("visualisation", *FENCE)
    flight.await_node()

    def text_of() -> dict[str, Any]:
        publisher.publish(written_corridor(corridor, stamp_ns=1, frame_id="odom"))
        flight.tick()
        return {marker.ns: marker for array in flight.text_of for marker in array.markers}

    assert peer.wait(lambda: "corridor" in text_of() and text_of()["corridor"].points)
    found = text_of()
    assert len(found["corridor"].points) == 2 * 12
    assert max(point.x for point in found["corridor"].points) == pytest.approx(1.0, abs=1e-3)


def test_an_odometry_that_is_not_finite_is_not_shown(start: Start, peer: Any) -> None:
    flight = Flight(peer)
    start("visualisation", *FENCE)
    flight.await_node()
    for _ in range(10):
        flight.tick(x=float("nan"))
    assert flight.text_of == []
    flight.tick()
    assert peer.wait(lambda: flight.text_of)

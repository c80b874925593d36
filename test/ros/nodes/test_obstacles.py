# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The MPC node receives obstacles from other processes, and tolerates invalid messages."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.interleaving import interleaved
from geometry_msgs.msg import Pose, PoseArray
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from quad_mpc_ros.extras.obstacles.markers import shape_marker
from quad_mpc_ros.messages import diagnostics
from quad_mpc_ros.messages.markers import filled_marker
from quad_mpc_ros.messages.point_cloud import PointCloud, written_point_cloud
from quad_mpc_ros.ros.messages import new_message
from quad_mpc_ros.ros.nodes import obstacle_inputs
from quad_mpc_ros.ros.nodes.obstacle_inputs import ObstacleInputs
from quad_mpc_ros.simulation.shapes import Sphere

Start = Callable[..., Any]
ON = ("-p", "obstacles.half_spaces:=4")


class Surveyor:
    """Publishes obstacles for a vehicle at rest at the origin, and receives its clearance."""

    def __init__(self, peer: Any) -> None:
        self._peer, node = peer, peer.node
        self.clouds = node.create_publisher(PointCloud2, "obstacles", qos_profile_sensor_data)
        self.markers = node.create_publisher(MarkerArray, "obstacle_markers", 10)
        self.stats: dict[str, str] = {}
        node.create_subscription(DiagnosticArray, "mpc/stats", self._on_stats, 10)

    def _on_stats(self, message: DiagnosticArray) -> None:
        self.stats = diagnostics.stats_from_message(message)

    @property
    def clearance(self) -> float:
        return float(self.stats.get("clearance_m", "nan"))

    def send_points(self, points: Any, *, frame_id: str = "base_link", late: float = 0.0) -> None:
        stamp_ns = int(self._peer.node.get_clock().now().nanoseconds) - round(1e9 * late)
        p_SQ = np.array(points, dtype=np.float32).reshape(-1, 3)
        cloud = PointCloud(stamp_ns=stamp_ns, frame_id=frame_id, p_SQ=p_SQ)
        self.clouds.publish(written_point_cloud(cloud))

    def send_ball(self, x: float) -> None:
        ball = Sphere(p_WO=np.array([x, 0.0, 0.0]), radius=0.5)
        message = MarkerArray()
        marker = shape_marker(ball, 7, stamp_ns=0, frame_id="odom")
        message.markers = [filled_marker(marker, new=new_message)]
        self.markers.publish(message)

    def sees(self, clearance: float, send: Callable[[], None]) -> bool:
        """Send until the controller's clearance is near a value; return whether it became so."""

        def near() -> bool:
            send()
            return math.isclose(self.clearance, clearance, abs_tol=0.06)

        return bool(self._peer.wait(near))


def test_receives_clouds_markers_and_neighbours_and_reports_a_sensor_that_stops(
    start: Start, peer: Any, feed: Any, managed: Any
) -> None:
    """The vehicle has a radius of 0.2 m; a ball of 0.5 m is nearer than the points."""
    surveyor, mpc = Surveyor(peer), managed("mpc")
    odometry = peer.node.create_publisher(Odometry, "/uav2/odom", qos_profile_sensor_data)
    feed.height = 0.0
    start("mpc", *ON, "-p", "obstacles.neighbours:=[uav2]")
    assert mpc.reports("active")

    def send_points() -> None:
        surveyor.send_points([[0.0, 2.0, 0.0], [3.0, 0.0, 0.0]])

    assert surveyor.sees(1.8, send_points)
    assert mpc.reports("active", "no usable cloud on obstacles for")
    assert peer.wait(lambda: math.isinf(surveyor.clearance))  # it is forgotten
    assert surveyor.sees(1.8, send_points)
    assert surveyor.sees(0.8, lambda: surveyor.send_ball(1.5))
    assert peer.wait(lambda: int(mpc.health["obstacles.markers"]) > 0)
    assert int(mpc.health["obstacles.clouds"]) > 0

    def is_received() -> bool:
        message = Odometry()
        message.header.stamp = peer.node.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = "odom", "base_link"
        message.pose.pose.position.x, message.pose.pose.orientation.w = 3.0, 1.0
        odometry.publish(message)
        return mpc.health.get("obstacles.neighbours") == "1 of 1"

    assert mpc.health["obstacles.neighbours"] == "0 of 1"
    assert peer.wait(is_received)


def test_malformed_late_and_unknown_frame_clouds_are_rejected(
    start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    surveyor, mpc = Surveyor(peer), managed("mpc")
    start("mpc", *ON)
    assert mpc.reports("active")
    log = tmp_path / "mpc.log"
    bad: dict[str, Callable[[], None]] = {
        "none of them finite": lambda: surveyor.send_points(np.full((50, 3), np.nan)),
        "frame 'moon'": lambda: surveyor.send_points([[1, 0, 0]], frame_id="moon"),
        "before the newest odometry": lambda: surveyor.send_points([[1, 0, 0]], late=5.0),
        "after the newest odometry": lambda: surveyor.send_points([[1, 0, 0]], late=-5.0),
        "without x, y, z": lambda: surveyor.clouds.publish(PointCloud2(height=1, width=3)),
    }
    for reason, send in bad.items():

        def is_logged(reason: str = reason, send: Callable[[], None] = send) -> bool:
            send()
            return reason in log.read_text()

        assert peer.wait(is_logged), reason
    assert peer.wait(lambda: int(mpc.health.get("obstacles.refused", 0)) >= len(bad))
    assert "Traceback" not in log.read_text()
    surveyor.stats.clear()
    assert peer.wait(lambda: surveyor.stats.get("source") == "mpc")


@pytest.mark.parametrize("call", ["take_warnings", "refuse", "accept"])
def test_a_cloud_refused_by_the_other_thread_is_counted_and_logged_once(call: str) -> None:
    """The other thread interrupts the executor at each bytecode: no count or refusal is lost."""
    made: list[ObstacleInputs] = []

    def refuse(_: object) -> None:
        raise ValueError("none is finite")

    def prepare() -> tuple[Callable[[], Any], Callable[[], object]]:
        world = Mock(neighbours=(), receive_cloud=refuse)
        made.append(ObstacleInputs(Mock(), world, Mock(), lockstep=True))
        inputs = made[-1]
        counted = {
            "accept": inputs._counted("markers", lambda _: None),
            "refuse": inputs._counted("markers", refuse),
        }
        calls = {name: functools.partial(each, b"") for name, each in counted.items()}
        calls["refuse"]()  # one that waits to be logged
        calls["take_warnings"] = inputs.take_warnings
        cloud = PointCloud(stamp_ns=0, frame_id="odom", p_SQ=np.zeros((1, 3), dtype=np.float32))
        return calls[call], functools.partial(inputs._read_cloud, written_point_cloud(cloud))

    def waits() -> bool:
        return made[-1]._condition._is_owned()

    refused = 3 if call == "refuse" else 2
    for taken in interleaved(prepare, obstacle_inputs, waits=waits):
        assert made[-1]._counts["refused"] == refused
        assert made[-1]._counts["markers"] == (call == "accept")
        assert len([*(taken or []), *made[-1].take_warnings()]) == refused
    assert len(made) > 20


def test_accepts_moved_gates_and_refuses_invalid_ones(
    start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    gates = peer.node.create_publisher(PoseArray, "gates", 10)
    mpc, log = managed("mpc"), tmp_path / "mpc.log"
    start("mpc", "-p", "formulation:=contouring", "-p", "gates:=split_s")
    assert mpc.reports("active")
    for count, frame_id, reason in (
        (7, "moon", "gates are in frame 'moon', expected 'odom'"),
        (3, "odom", "given 3 poses, expected one per gate, 7"),
    ):
        message = PoseArray(poses=[Pose() for _ in range(count)])
        message.header.frame_id = frame_id

        def is_logged(message: PoseArray = message, reason: str = reason) -> bool:
            gates.publish(message)
            return reason in log.read_text()

        assert peer.wait(is_logged), reason
    assert "Traceback" not in log.read_text()

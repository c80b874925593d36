"""The MPC node receives obstacles from other processes, and tolerates invalid messages."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.processes import PATIENCE
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
        cloud = PointCloud(stamp_ns=stamp_ns, frame_id=frame_id, p_SQ=p_SQ, given=len(p_SQ))
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


def test_a_cloud_and_a_marker_of_another_process_are_known(
    start: Start, peer: Any, feed: Any, managed: Any
) -> None:
    """The vehicle has a radius of 0.2 m; a ball of 0.5 m is nearer than the points."""
    surveyor, mpc = Surveyor(peer), managed("mpc")
    feed.height = 0.0
    start("mpc", *ON)
    assert mpc.reports("active")
    assert surveyor.sees(1.8, lambda: surveyor.send_points([[0.0, 2.0, 0.0], [3.0, 0.0, 0.0]]))
    assert surveyor.sees(0.8, lambda: surveyor.send_ball(1.5))
    assert peer.wait(lambda: int(mpc.health.get("obstacles.clouds", 0)) > 0)
    assert int(mpc.health["obstacles.markers"]) > 0


def test_broken_late_and_foreign_clouds_are_refused_and_the_mpc_flies_on(
    start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    surveyor, mpc = Surveyor(peer), managed("mpc")
    start("mpc", *ON)
    assert mpc.reports("active")
    log = tmp_path / "mpc.log"
    bad: dict[str, Callable[[], None]] = {
        "of which none is finite": lambda: surveyor.send_points(np.full((50, 3), np.nan)),
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


def test_accepts_moved_gates_and_refuses_invalid_ones(
    start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    gates = peer.node.create_publisher(PoseArray, "gates", 10)
    mpc, log = managed("mpc"), tmp_path / "mpc.log"
    start("mpc", "-p", "formulation:=contouring", "-p", "gates:=split_s")
    assert mpc.reports("active")
    for count, frame_id, reason in (
        (7, "moon", "gates are in frame 'moon', expected 'odom'"),
        (3, "odom", "given 3 poses, expected those of all 7 gates"),
    ):
        message = PoseArray(poses=[Pose() for _ in range(count)])
        message.header.frame_id = frame_id

        def is_logged(message: PoseArray = message, reason: str = reason) -> bool:
            gates.publish(message)
            return reason in log.read_text()

        assert peer.wait(is_logged), reason
    assert "Traceback" not in log.read_text()


def test_diagnostics_report_a_sensor_that_stops(
    start: Start, peer: Any, feed: Any, managed: Any
) -> None:
    surveyor, mpc = Surveyor(peer), managed("mpc")
    start("mpc", *ON)
    assert mpc.reports("active")
    assert surveyor.sees(1.8, lambda: surveyor.send_points([[0.0, 2.0, 0.0]]))
    assert mpc.reports("active", "no usable cloud on obstacles for")
    assert peer.wait(lambda: math.isinf(surveyor.clearance))  # it is forgotten
    assert surveyor.sees(1.8, lambda: surveyor.send_points([[0.0, 2.0, 0.0]]))


def test_receives_a_neighbour_in_its_namespace(
    start: Start, peer: Any, feed: Any, managed: Any
) -> None:
    mpc = managed("mpc")
    odometry = peer.node.create_publisher(Odometry, "/uav2/odom", qos_profile_sensor_data)
    start("mpc", *ON, "-p", "obstacles.neighbours:=[uav2]")
    assert mpc.reports("active")

    def is_received() -> bool:
        message = Odometry()
        message.header.stamp = peer.node.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = "odom", "base_link"
        message.pose.pose.position.x, message.pose.pose.orientation.w = 3.0, 1.0
        odometry.publish(message)
        return mpc.health.get("obstacles.neighbours") == "1 of 1"

    assert mpc.health.get("obstacles.neighbours", "0 of 1") == "0 of 1"
    assert peer.wait(is_received)


def test_without_half_spaces_nothing_is_subscribed(
    start: Start, peer: Any, feed: Any, managed: Any
) -> None:
    mpc = managed("mpc")
    start("mpc")
    assert mpc.reports("active")
    peer.spin(0.5)
    for topic in ("obstacles", "obstacle_markers"):
        assert peer.node.count_subscribers(topic) == 0


def test_does_not_start_with_an_invalid_file(start: Start, tmp_path: Path) -> None:
    file = tmp_path / "obstacles.yaml"
    file.write_text("obstacles: [{shape: cube}]")
    process = start("mpc", *ON, "-p", f"obstacles.file:={file}")
    assert process.wait(PATIENCE) == 2
    log = (tmp_path / "mpc.log").read_text()
    assert "obstacle 1: shape: given 'cube'" in log and "Traceback" not in log

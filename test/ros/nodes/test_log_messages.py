# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""An inactive MPC logs missing and mismatched inputs."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TransformStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from std_msgs.msg import Bool
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from quad_mpc_ros.ros.repeated_warnings import RepeatedWarnings

Start = Callable[..., Any]


def test_logs_missing_inputs_and_mismatched_publishers(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    log = tmp_path / "mpc.log"
    start("mpc", "-r", "__ns:=/one")
    assert peer.wait(
        lambda: "inactive: no odometry yet: no publisher on /one/odom" in log.read_text()
    )
    odometry = peer.node.create_publisher(Odometry, "/one/odom", qos_profile_sensor_data)
    peer.node.create_publisher(MultiDOFJointTrajectory, "/one/reference", qos_profile_sensor_data)
    message = Odometry()
    message.header.frame_id = "map"
    message.pose.pose.orientation.w = 1.0
    peer.node.create_timer(0.02, lambda: odometry.publish(message))
    expected = (
        "no reference yet: 1 publisher on /one/reference, not received: quality of service of"
    )
    assert peer.wait(lambda: f"{expected} /test_peer: " in log.read_text())


def test_logs_each_failsafe_level_and_flies_on_when_the_inputs_return(
    start: Start, peer: Any, feed: Any, tmp_path: Path
) -> None:
    process, log = start("mpc"), tmp_path / "mpc.log"

    def logged(text: str, times: int = 1) -> bool:
        return bool(peer.wait(lambda: log.read_text().count(text) >= times))

    assert logged("the MPC flies")
    feed.odometry = False
    assert logged("blind takes over: odometry is")
    assert logged("silent takes over: odometry is")
    feed.odometry = True
    assert logged("the MPC flies", times=2)
    feed.reference = False
    assert logged("hover takes over: reference is")
    feed.reference = True
    assert logged("the MPC flies", times=3)
    assert process.poll() is None


def test_warns_of_each_kind_at_once_and_every_five_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    node, now = Mock(), 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    warnings = RepeatedWarnings(node)
    for tick in range(600):
        now = 0.02 * tick
        warnings.warn(f"odometry is {tick}.5 s old in frame '{tick}'")
        if tick == 5:
            warnings.warn("position jumped by 30.0 m")
    texts = [call.args[0] for call in node.get_logger().warning.call_args_list]
    assert [text[:8] for text in texts] == ["odometry", "position", "odometry", "odometry"]


VOLATILE, BEST_EFFORT = QoSProfile(depth=1), qos_profile_sensor_data
MISMATCHED: dict[str, tuple[type[Any], QoSProfile, str]] = {
    "landed": (Bool, VOLATILE, "volatile publisher"),
    "obstacle_markers": (MarkerArray, BEST_EFFORT, "best effort publisher"),
    "odom_reset": (TransformStamped, BEST_EFFORT, "best effort publisher"),
    "obstacles": (Twist, BEST_EFFORT, "publishes geometry_msgs/msg/Twist, expected"),
}


def test_reports_publishers_that_do_not_match_an_optional_input(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    """The log has the report once, the diagnostics as long as the publishers exist."""
    mpc = managed("mpc")
    publishers = [
        peer.node.create_publisher(kind, topic, qos)
        for topic, (kind, qos, _) in MISMATCHED.items()
    ]
    start("mpc", "-p", "obstacles.half_spaces:=4")

    def reports(text: str) -> bool:
        return all(
            re.search(f"{topic}: [^;]*{why}", text) for topic, (_, _, why) in MISMATCHED.items()
        )

    log = tmp_path / "mpc.log"
    assert peer.wait(lambda: reports(log.read_text())), log.read_text()
    assert peer.wait(lambda: reports(mpc.health.get("text", ""))), mpc.health
    for publisher in publishers:
        peer.node.destroy_publisher(publisher)
    assert peer.wait(lambda: "test_peer" not in mpc.health["text"]), mpc.health
    assert log.read_text().count("messages are not delivered") == len(publishers)


def test_contradictions_are_searched_for_once_something_receives_the_commands(
    start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    feed.height = 1.0  # below the reference, and it does not climb
    start("mpc")
    mpc, log = managed("mpc"), tmp_path / "mpc.log"

    def alone_for_five_seconds() -> bool:
        commands = int(mpc.health.get("commands", "0"))
        return commands > 250 and "nothing subscribes to /command" in mpc.health["text"]

    assert peer.wait(alone_for_five_seconds)
    assert mpc.level == DiagnosticStatus.WARN
    assert "takes over" not in log.read_text()
    peer.node.create_subscription(TwistStamped, "command", lambda _: None, qos_profile_sensor_data)
    assert peer.wait(lambda: "takes over: " in log.read_text())
    assert "nothing subscribes" not in mpc.health["text"]

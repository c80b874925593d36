"""What an inactive MPC waits for is in its log, at once and as long as it lasts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quad_mpc_ros.ros.repeated_warnings import RepeatedWarnings

Start = Callable[..., Any]


def test_says_what_it_waits_for_and_why_it_is_not_heard(
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
    told = "no reference yet: 1 publisher on /one/reference, not heard: quality of service of"
    assert peer.wait(lambda: f"{told} /test_peer: " in log.read_text())


def test_says_at_once_and_again_that_odometry_is_in_a_wrong_frame(
    start: Start, peer: Any, feed: Any, tmp_path: Path
) -> None:
    start("mpc", "-p", "odometry.frame_id:=map")
    log = tmp_path / "mpc.log"
    told = "inactive: odometry is in frame 'odom', expected 'map'"
    assert peer.wait(lambda: told in log.read_text())
    first = time.monotonic()
    assert peer.wait(lambda: log.read_text().count(told) == 2)
    assert time.monotonic() - first > 4.0


class Clock:
    """Seconds as the test says."""

    now = 0.0


@pytest.fixture
def logged(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[RepeatedWarnings, list[str], Clock]]:
    texts, clock = [], Clock()

    class Logger:
        def warning(self, text: str) -> None:
            texts.append(text)

    class Node:
        def get_logger(self) -> Logger:
            return Logger()

    monkeypatch.setattr(time, "monotonic", lambda: clock.now)
    yield RepeatedWarnings(Node()), texts, clock


def test_warns_of_each_kind_at_once_and_every_five_seconds(
    logged: tuple[RepeatedWarnings, list[str], Clock],
) -> None:
    warnings, texts, clock = logged
    for tick in range(600):
        clock.now = 0.02 * tick
        warnings.warn(f"odometry is {tick}.5 s old in frame '{tick}'")
        if tick == 5:
            warnings.warn("position jumped by 30.0 m")
    assert [text[:8] for text in texts] == ["odometry", "position", "odometry", "odometry"]

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""An accelerometer over DDS: bad messages and silence."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

from quad_mpc_ros.messages import conversions

NOISE = "advanced.accelerometer_noise"


def imu(now_ns: int, **changes: Any) -> Imu:
    message = Imu()
    conversions.fill_time(message.header.stamp, changes.get("stamp_ns", now_ns))
    message.header.frame_id = changes.get("frame_id", "base_link")
    message.linear_acceleration.z = changes.get("z", 9.81)
    message.linear_acceleration_covariance[0] = changes.get("variance", 0.0)
    return message


BAD = {
    "imu linear_acceleration.z is not finite": {"z": math.nan},
    "imu is in frame 'imu_link', expected 'base_link'": {"frame_id": "imu_link"},
    "behind the odometry's stamp": {"stamp_ns": 5},
    "imu has no acceleration": {"variance": -1.0},
}


def test_bad_messages_are_logged_and_the_flight_continues(
    start: Callable[..., Any], peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    publisher = peer.node.create_publisher(Imu, "imu", qos_profile_sensor_data)
    start("mpc", "-p", f"{NOISE}:=0.5")
    node, log = managed("mpc"), tmp_path / "mpc.log"

    def silent() -> bool:
        return "the accelerometer is silent" in node.health.get("text", "")

    def send(**changes: Any) -> None:
        publisher.publish(imu(int(peer.node.get_clock().now().nanoseconds), **changes))

    assert peer.wait(silent)
    for reason, changes in BAD.items():

        def refused(reason: str = reason, changes: dict[str, Any] = changes) -> bool:
            send(**changes)
            return reason in log.read_text()

        assert peer.wait(refused)
        assert len([line for line in log.read_text().splitlines() if reason in line]) == 1
    assert peer.wait(lambda: int(node.health["rejected_inputs"]) > 0)
    assert silent()

    def is_received() -> bool:
        send()
        return node.health["accelerometer"] != "missing"

    assert peer.wait(is_received)
    assert "Traceback" not in log.read_text()

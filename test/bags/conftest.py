"""What the tests of bags share: times, a codec, and a small bag written by this package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from quad_mpc_ros.bags import BagWriter, QosProfile, RosbagsMessages

START_NS = 1_700_000_000_000_000_000
STEP_NS = 20_000_000


@pytest.fixture(scope="session")
def codec() -> RosbagsMessages:
    return RosbagsMessages()


@pytest.fixture
def write_flight(codec: RosbagsMessages) -> Callable[[BagWriter, int], None]:
    """Return a function that writes ``count`` odometry messages and half as many commands."""

    def write(writer: BagWriter, count: int) -> None:
        writer.add_topic(
            "/odom",
            "nav_msgs/msg/Odometry",
            qos_profiles=[QosProfile(reliability="best_effort", depth=1)],
        )
        writer.add_topic("/command", "geometry_msgs/msg/TwistStamped", qos_profiles=[QosProfile()])
        for index in range(count):
            stamp = START_NS + index * STEP_NS
            odometry = codec.new("nav_msgs/msg/Odometry")
            odometry.header.frame_id = "odom"
            odometry.header.stamp.sec = stamp // 10**9
            odometry.header.stamp.nanosec = stamp % 10**9
            odometry.pose.pose.position.x = float(index)
            writer.write(
                "/odom",
                codec.encode("nav_msgs/msg/Odometry", odometry),
                log_time_ns=stamp + 1000,
                publish_time_ns=stamp,
            )
            if index % 2 == 0:
                command = codec.new("geometry_msgs/msg/TwistStamped")
                command.twist.linear.z = 0.001 * index
                writer.write(
                    "/command",
                    codec.encode("geometry_msgs/msg/TwistStamped", command),
                    log_time_ns=stamp + 2000,
                    publish_time_ns=stamp + 1500,
                )

    return write


@pytest.fixture
def flight_bag(tmp_path: Path, write_flight: Callable[[BagWriter, int], None]) -> Path:
    """Return a finished bag of 10 odometry messages and 5 commands."""
    directory = tmp_path / "flight"
    with BagWriter(directory) as writer:
        write_flight(writer, 10)
        writer.write_metadata("parameters", {"mpc": "control_rate: 50.0"})
    return directory

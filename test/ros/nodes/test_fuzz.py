# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Invalid messages on any topic cause no exception and no invalid command."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import rclpy
from fixtures.fuzzing import ALL, spoil
from geometry_msgs.msg import PoseStamped, Transform, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.messages import cdr, conversions
from quad_mpc_ros.ros.clocks import SteadyTime
from quad_mpc_ros.ros.command_ownership import CommandOwnership
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode
from quad_mpc_ros.ros.nodes.simulator_node import SimulatorNode
from quad_mpc_ros.ros.nodes.visualisation_node import VisualisationNode

# To each subscription: a short run of every case, and a long one of the nodes as they are.
SHORT, LONG = 1_000, 10_000
SEED = 7

NODES: dict[str, tuple[Callable[[], Any], list[str]]] = {
    "mpc": (MpcNode, []),
    "mpc, world twist": (MpcNode, ["odometry.twist_frame:=world", "fence.maximum:=[9.0,9.0,9.0]"]),
    "mpc, lockstep": (MpcNode, ["lockstep:=true"]),
    "mpc, accelerometer": (MpcNode, ["advanced.accelerometer_noise:=0.5"]),
    "reference": (ReferenceNode, []),
    "reference, on request": (ReferenceNode, ["mode:=on_request"]),
    "simulator": (SimulatorNode, []),
    "visualisation": (VisualisationNode, []),
}


class Messages:
    """Makes messages: as they should be but for some fields, or for all of them."""

    def __init__(self) -> None:
        self.random = random.Random(SEED)

    def make(self, kind: type[Any], now_ns: int) -> Any:
        """Return one of a kind."""
        message = SOUND[kind](now_ns)
        count = self.random.choice((0, 0, 0, 1, 1, 2, 3, ALL))
        if kind in REQUESTS and self.random.random() < 0.95:
            count = max(count, 8)  # what could be flown is planned for, which takes its time
        spoil(message, count, self.random)
        return message


def _stamped(message: Any, now_ns: int) -> Any:
    conversions.fill_time(message.header.stamp, now_ns)
    message.header.frame_id = "odom"
    return message


def odometry(now_ns: int) -> Odometry:
    message = _stamped(Odometry(), now_ns)
    message.child_frame_id = "base_link"
    message.pose.pose.position.z = 2.0
    message.pose.pose.orientation.w = 1.0
    message.twist.twist.linear.x = 0.1 * (now_ns % 7)
    return message


def trajectory(now_ns: int) -> MultiDOFJointTrajectory:
    message = _stamped(MultiDOFJointTrajectory(), now_ns)
    message.joint_names = ["base_link"]
    for k in range(4):
        transform, velocity = Transform(), Twist()
        transform.translation.z, transform.rotation.w = 2.0, 1.0
        transform.translation.x = velocity.linear.x = 0.1 * k
        point = MultiDOFJointTrajectoryPoint(
            transforms=[transform], velocities=[velocity], accelerations=[Twist()]
        )
        point.time_from_start.sec = k
        message.points.append(point)
    return message


def pose(now_ns: int) -> PoseStamped:
    message = _stamped(PoseStamped(), now_ns)
    message.pose.position.x, message.pose.position.z = 1.0, 2.0
    message.pose.orientation.w = 1.0
    return message


def command(now_ns: int) -> TwistStamped:
    message = _stamped(TwistStamped(), now_ns)
    message.twist.linear.z, message.twist.angular.y = 0.3, 0.1
    return message


def imu(now_ns: int) -> Imu:
    message = _stamped(Imu(), now_ns + 1_000_000 * (now_ns % 19))
    message.header.frame_id = "base_link"
    message.linear_acceleration.z = 9.81
    return message


def path(now_ns: int) -> Path:
    message = _stamped(Path(), now_ns)
    message.poses = [pose(now_ns) for _ in range(3)]
    return message


SOUND: dict[type[Any], Callable[[int], Any]] = {
    Odometry: odometry,
    MultiDOFJointTrajectory: trajectory,
    PoseStamped: pose,
    TwistStamped: command,
    Path: path,
    Imu: imu,
    Bool: lambda _: Bool(data=True),
}


class Time:
    """The time of the MPC node, which passes with the messages."""

    def __init__(self) -> None:
        self.ns = 1_700_000_000 * 10**9

    def now_ns(self) -> int:
        return self.ns

    def pass_by(self) -> int:
        """Let 5 ms pass and return a stamp, which four messages share as lockstep wants it."""
        self.ns += 5_000_000
        return self.ns - self.ns % 20_000_000


REQUESTS = (PoseStamped, MultiDOFJointTrajectory)


@pytest.fixture
def passing_time(monkeypatch: pytest.MonkeyPatch) -> Time:
    passing = Time()
    monkeypatch.setattr(SteadyTime, "now_ns", lambda _: passing.now_ns())
    monkeypatch.setattr(CommandOwnership, "is_discovering", False)  # no other node
    return passing


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[CommandSample]:
    """Return what is sent as a command, as it is sent."""
    sent: list[CommandSample] = []
    written = cdr.written_command

    def spy(sample: CommandSample) -> bytes:
        sent.append(sample)
        return written(sample)

    monkeypatch.setattr(cdr, "written_command", spy)
    return sent


@pytest.mark.parametrize(
    ("case", "count"),
    [
        *((case, SHORT) for case in NODES),
        *(
            pytest.param(case, LONG, marks=[pytest.mark.slow, pytest.mark.timeout(600)])
            for case in NODES
            if "," not in case
        ),
    ],
)
def test_random_input_never_raises(
    case: str, count: int, commands: list[CommandSample], passing_time: Time
) -> None:
    make, parameters = NODES[case]
    given = [part for parameter in parameters for part in ("-p", parameter)]
    rclpy.init(args=["--ros-args", *given, "--log-level", "FATAL"])
    node = make()
    try:
        messages, subscriptions = Messages(), list(node.subscriptions)
        own = [each for each in subscriptions if each.msg_type in SOUND]
        assert own
        for k in range(count * len(own)):
            subscription = own[k % len(own)]
            stamp_ns = passing_time.pass_by()
            if not case.startswith("mpc"):
                stamp_ns = int(node.get_clock().now().nanoseconds)
            message = messages.make(subscription.msg_type, stamp_ns)
            try:
                subscription.callback(serialize_message(message) if subscription.raw else message)
            except Exception as error:
                raise AssertionError(f"message {k} of seed {SEED}: {message}") from error
    finally:
        node.destroy_node()
        rclpy.shutdown()
    assert (len(commands) > 20) == case.startswith("mpc")
    config = MpcConfig()
    for sent in commands:
        assert config.throttle_min <= sent.throttle <= config.throttle_max
        assert np.isfinite(sent.w_WB_B).all()
        assert (np.abs(sent.w_WB_B) <= config.omega_max).all()

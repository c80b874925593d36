# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The bridge to Aerostack2, compared with its documentation: ENU, FLU and newton."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from fixtures.bridges import AXES, SECOND, T0, command, deliver, set_q, vector
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.extras.bridges import aerostack2
from quad_mpc_ros.extras.bridges.aerostack2 import Aerostack2Bridge

New = Callable[[str], Any]

NOW_NS = 5_250_000_000


@pytest.mark.parametrize("axis", AXES)
def test_aerostack2_takes_flu_and_newton(new: New, axis: tuple[float, ...]) -> None:
    twist, thrust = new("geometry_msgs/msg/TwistStamped"), new("as2_msgs/msg/Thrust")
    aerostack2.fill_body_rates(twist, command(w=axis), frame_id="drone0/base_link", now_ns=NOW_NS)
    aerostack2.fill_thrust(
        thrust, thrust_newton=7.5, throttle=0.4, frame_id="drone0/base_link", now_ns=NOW_NS
    )
    assert vector(twist.twist.angular) == axis
    assert vector(twist.twist.linear) == (0.0, 0.0, 0.0)
    assert thrust.thrust == 7.5
    assert thrust.thrust_normalized == pytest.approx(0.4)
    assert thrust.header.frame_id == twist.header.frame_id == "drone0/base_link"


@pytest.mark.parametrize(
    ("frame", "v_B"),
    # Heading north, one metre per second to the east: to the right, -y in FLU.
    [("earth", [0.0, -1.0, 0.0]), ("drone0/odom", [0.0, -1.0, 0.0])],
)
def test_aerostack2_rotates_a_world_frame_twist(new: New, frame: str, v_B: list[float]) -> None:
    pose, twist = new("geometry_msgs/msg/PoseStamped"), new("geometry_msgs/msg/TwistStamped")
    set_q(pose.pose.orientation, so3.exp([0.0, 0.0, math.pi / 2.0]))
    twist.header.frame_id = frame
    twist.twist.linear.x = 1.0
    odometry = aerostack2.odometry_from_self_localization(pose, twist)
    assert_allclose(odometry.v_WB_B, v_B, atol=1e-12)


def test_aerostack2_refuses_a_twist_of_an_unknown_frame(new: New) -> None:
    pose, twist = new("geometry_msgs/msg/PoseStamped"), new("geometry_msgs/msg/TwistStamped")
    pose.pose.orientation.w = 1.0
    twist.header.frame_id = "camera"
    with pytest.raises(ValueError, match="'camera', expected base_link"):
        aerostack2.odometry_from_self_localization(pose, twist)


def test_aerostack2_poses_and_twists_are_paired_by_time(new: New) -> None:
    bridge = Aerostack2Bridge(Aerostack2Bridge.Config(), new)
    pose, twist = new("geometry_msgs/msg/PoseStamped"), new("geometry_msgs/msg/TwistStamped")
    pose.pose.orientation.w, twist.header.frame_id = 1.0, "base_link"
    pose.header.stamp.sec = 100
    twist.header.stamp.sec, twist.header.stamp.nanosec = 99, 980_000_000
    names = "/drone0/self_localization/pose", "/drone0/self_localization/twist"
    assert deliver(bridge, names[0], pose, T0) is None
    assert deliver(bridge, names[1], twist, T0) is None
    twist.header.stamp.sec, twist.header.stamp.nanosec = 100, 0
    odometry = deliver(bridge, names[1], twist, T0)
    assert odometry is not None
    assert odometry.stamp_ns == 100 * SECOND
    assert deliver(bridge, names[1], twist, T0) is None  # each is used once

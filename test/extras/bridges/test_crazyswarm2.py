# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The bridge to Crazyswarm2, compared with its documentation: degrees and PWM."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.bridges import AXES, SECOND, T0, command, deliver, engage, ready_to_fly, set_q
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.bridges import crazyswarm2
from quad_mpc_ros.extras.bridges.crazyswarm2 import Crazyswarm2Bridge

New = Callable[[str], Any]


@pytest.mark.parametrize(
    ("w", "field", "degrees"),
    [
        ((math.pi, 0.0, 0.0), "linear.y", 180.0),
        ((-math.pi, 0.0, 0.0), "linear.y", -180.0),
        ((0.0, math.pi / 2.0, 0.0), "linear.x", 90.0),  # nose down
        ((0.0, -math.pi / 2.0, 0.0), "linear.x", -90.0),
        ((0.0, 0.0, 1.0), "angular.z", -57.29577951308232),  # clockwise is positive there
        ((0.0, 0.0, -1.0), "angular.z", 57.29577951308232),
    ],
)
def test_crazyswarm2_setpoint_uses_degrees_and_legacy_axes(
    new: New, w: tuple[float, ...], field: str, degrees: float
) -> None:
    message = new("geometry_msgs/msg/Twist")
    crazyswarm2.fill_setpoint(message, command(w=w), throttle=0.5)
    part, name = field.split(".")
    assert getattr(getattr(message, part), name) == pytest.approx(degrees)
    others = {"linear.x", "linear.y", "angular.x", "angular.y", "angular.z"} - {field}
    assert all(getattr(getattr(message, f.split(".")[0]), f[-1]) == 0.0 for f in others)


def turning(w_WB_B: Array) -> list[OdometrySample]:
    return [
        dataclasses.replace(
            OdometrySample.at_rest(np.zeros(3), stamp_ns=i * 10_000_000),
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(
                so3.exp([0.0, 0.0, 3.0]) @ so3.exp(0.01 * i * w_WB_B)
            ),
        )
        for i in range(80)
    ]


@pytest.mark.parametrize("axis", AXES)
def test_attitudes_of_a_steady_turn_give_its_rates(axis: tuple[float, ...]) -> None:
    w_WB_B = 4.0 * np.array(axis)
    differentiator = crazyswarm2.RateDifferentiator()
    found = [differentiator.completed(each) for each in turning(w_WB_B)]
    assert found[0] is None
    for odometry in found[1:]:  # through the double cover of quaternions as well
        assert odometry is not None
        assert_allclose(odometry.w_WB_B, w_WB_B, atol=1e-6)


@pytest.mark.parametrize(
    ("throttle", "pwm"), [(0.0, 0.0), (0.5, 32767.5), (0.9, 58981.5), (1.0, 60000.0)]
)
def test_crazyswarm2_thrust_is_limited_pwm(new: New, throttle: float, pwm: float) -> None:
    message = new("geometry_msgs/msg/Twist")
    crazyswarm2.fill_setpoint(message, command(), throttle=throttle)
    assert message.linear.z == pytest.approx(pwm)


def test_crazyswarm2_velocity_is_in_the_world_frame(new: New) -> None:
    message = new("nav_msgs/msg/Odometry")
    set_q(message.pose.pose.orientation, so3.exp([0.0, 0.0, math.pi / 2.0]))
    message.twist.twist.linear.y = 2.0  # north, which is ahead
    assert_allclose(crazyswarm2.odometry_from_odom(message).v_WB_B, [2.0, 0.0, 0.0], atol=1e-12)


def test_unlocks_first_and_after_motor_cut(new: New) -> None:
    bridge = ready_to_fly(Crazyswarm2Bridge, T0)

    def thrust(now_ns: int) -> float:
        (sending,) = bridge.receive_command(command(now_ns), now_ns=now_ns)
        return float(sending.message.linear.z)

    thrusts = [thrust(T0 + i * SECOND // 50) for i in range(6)]
    assert thrusts[:3] == [0.0] * 3
    assert min(thrusts[3:]) > 0.0
    # A gap in flight that the firmware bridges must not cut the motors.
    assert thrust(T0 + SECOND // 2) > 0.0
    assert bridge.receive_command(command(T0 + 4 * SECOND), now_ns=T0 + 4 * SECOND) == []
    assert engage(bridge, T0 + 4 * SECOND).accepted
    assert thrust(T0 + 4 * SECOND) == 0.0


def test_release_in_flight_requests_hold(new: New) -> None:
    bridge = ready_to_fly(Crazyswarm2Bridge, T0)
    bridge.receive_command(command(T0), now_ns=T0)
    calls = bridge.engage(False, now_ns=T0).calls
    assert [call.service for call in calls] == ["/cf231/notify_setpoints_stop", "/cf231/go_to"]
    assert calls[0].request.remain_valid_millisecs == 100
    stay = calls[1].request
    assert (stay.relative, stay.goal.x, stay.goal.y, stay.goal.z, stay.yaw) == (True, 0, 0, 0, 0)
    assert bridge.receive_command(command(T0), now_ns=T0) == []


def test_announces_no_end_without_setpoints(new: New) -> None:
    assert Crazyswarm2Bridge(Crazyswarm2Bridge.Config(), new).engage(False, now_ns=T0).calls == ()


@pytest.mark.parametrize("bit", [32, 64])
def test_sends_nothing_to_tumbled_or_locked_crazyflie(new: New, bit: int) -> None:
    bridge = ready_to_fly(Crazyswarm2Bridge, T0)
    status = new("crazyflie_interfaces/msg/Status")
    status.supervisor_info = 2 | bit
    deliver(bridge, "/cf231/status", status, T0)
    assert bridge.receive_command(command(T0), now_ns=T0) == []

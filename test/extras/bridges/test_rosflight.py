# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The bridge to ROSflight, compared with its documentation: NED and FRD."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from fixtures.bridges import (
    AXES,
    FRD,
    HOVER,
    SECOND,
    T0,
    command,
    deliver,
    deliver_all,
    message_of,
    ready_to_fly,
    set_q,
)
from fixtures.stack_messages import sound_message
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.extras.bridges import rosflight
from quad_mpc_ros.extras.bridges.rosflight import RosflightBridge

New = Callable[[str], Any]

NOW_NS = 5_250_000_000


@pytest.mark.parametrize("axis", AXES)
def test_rosflight_command_has_frd_rates_after_three_forces(
    new: New, axis: tuple[float, ...]
) -> None:
    message = new("rosflight_msgs/msg/Command")
    rosflight.fill_command(message, command(w=axis), throttle=0.5, now_ns=NOW_NS)
    assert message.u.tolist() == [0.0, 0.0, 0.5, *FRD[axis], 0.0, 0.0, 0.0, 0.0]
    assert (message.mode, message.ignore) == (1, 0)


def test_rosflight_command_of_first_releases_has_six_named_values() -> None:
    class Header:
        class stamp:  # noqa: N801
            sec = nanosec = 0

    class First:
        header = Header
        mode = ignore = None
        qx = qy = qz = fx = fy = fz = math.nan

    message: Any = First()
    rosflight.fill_command(message, command(w=(1.0, 2.0, 3.0)), throttle=0.5, now_ns=0)
    assert (message.qx, message.qy, message.qz) == (1.0, -2.0, -3.0)
    assert (message.fx, message.fy, message.fz) == (0.0, 0.0, 0.5)


def test_rosflight_nose_down_heading_north_tilts_north(new: New) -> None:
    message = new("roscopter_msgs/msg/State")
    set_q(message.quat, so3.exp([0.0, -0.3, 0.0]))
    message.p_n, message.p_e, message.p_d = 1.0, 2.0, -3.0
    message.v_x, message.v_y, message.v_z = 4.0, 5.0, 6.0
    message.p, message.q, message.r = 0.1, 0.2, 0.3
    odometry = rosflight.odometry_from_state(message)
    assert_allclose(odometry.p_WB, [2.0, 1.0, 3.0])  # east, north, up
    assert_allclose(odometry.v_WB_B, [4.0, -5.0, -6.0])
    assert_allclose(odometry.w_WB_B, [0.1, -0.2, -0.3], rtol=1e-6)
    up_W = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)[:, 2]
    assert_allclose(up_W, [0.0, math.sin(0.3), math.cos(0.3)], atol=1e-12)


def test_rosflight_state_without_attitude_is_rejected(new: New) -> None:
    message = new("roscopter_msgs/msg/State")
    message.quat.w = 0.0
    with pytest.raises(ValueError, match="unit quaternion"):
        rosflight.odometry_from_state(message)


def test_rosflight_arming_and_handover_need_the_pilot(new: New) -> None:
    bridge = ready_to_fly(RosflightBridge, T0)
    assert not bridge.arm(True, now_ns=T0).accepted
    status = new("rosflight_msgs/msg/Status")
    status.armed = True
    bridge = RosflightBridge(RosflightBridge.Config(), new)
    deliver_all(bridge, T0)
    bridge.receive_command(command(T0, HOVER), now_ns=T0)
    deliver(bridge, "/status", status, T0)
    assert bridge.engage(True, now_ns=T0).accepted
    now_ns = T0
    for now_ns in range(T0, T0 + 10 * SECOND, SECOND // 50):  # he takes his time
        deliver_all(bridge, now_ns)
        deliver(bridge, "/status", status, now_ns)
        assert bridge.receive_command(command(now_ns, HOVER), now_ns=now_ns)
        assert not bridge.engaged(now_ns=now_ns)
    status.offboard = True
    deliver(bridge, "/status", status, now_ns)
    assert bridge.engaged(now_ns=now_ns)
    status.offboard = False
    deliver(bridge, "/status", status, now_ns)
    assert bridge.receive_command(command(now_ns, HOVER), now_ns=now_ns) == []


def engageable(new: New, **status: Any) -> RosflightBridge:
    """Return a bridge that has received all messages but RC, and a status with these values."""
    bridge = RosflightBridge(RosflightBridge.Config(), new)
    deliver_all(bridge, T0 - 2 * SECOND)
    bridge.receive_command(command(T0, HOVER), now_ns=T0)
    for each in bridge.subscriptions:
        if each.topic.name not in ("/rc_raw", "/status"):
            each.receive(sound_message(each.topic.type_name, T0), T0)
    message = sound_message("rosflight_msgs/msg/Status", T0)
    for name, value in status.items():
        setattr(message, name, value)
    deliver(bridge, "/status", message, T0)
    return bridge


def frames(bridge: RosflightBridge, new: New, *, rate: float) -> None:
    for number in range(20):
        now_ns = T0 - round((19 - number) * SECOND / rate)
        deliver(bridge, "/rc_raw", new("rosflight_msgs/msg/RCRaw"), now_ns)


def test_rosflight_without_rc_frames_is_not_engaged(new: New) -> None:
    bridge = engageable(new)
    refused = bridge.engage(True, now_ns=T0)
    assert not refused.accepted and "no RC frame within 0.5 s on /rc_raw" in refused.text
    frames(bridge, new, rate=400.0)
    assert bridge.engage(True, now_ns=T0).accepted
    assert not any("RC frames" in each for each in bridge.take_warnings())


def test_rosflight_warns_of_slow_rc_with_the_added_delay(new: New) -> None:
    bridge = engageable(new)
    frames(bridge, new, rate=50.0)
    assert bridge.engage(True, now_ns=T0).accepted
    assert any("at 50 Hz" in each and "add 10 ms" in each for each in bridge.take_warnings())


@pytest.mark.parametrize(
    ("code", "reason"), [(0x20, "IMU not calibrated"), (0x81, "PRIMARY_MIXER), FAILSAFE_THR")]
)
def test_rosflight_that_does_not_arm_is_not_engaged(new: New, code: int, reason: str) -> None:
    bridge = engageable(new, error_code=code)
    frames(bridge, new, rate=400.0)
    refused = bridge.engage(True, now_ns=T0)
    assert not refused.accepted and reason in refused.text


@pytest.mark.parametrize(("override", "follows"), [(0, True), (0x20, True), (0x01, False)])
def test_rosflight_follows_unless_the_pilot_overrides_more_than_the_throttle(
    new: New, override: int, follows: bool
) -> None:
    bridge = engageable(new, rc_override=override)
    frames(bridge, new, rate=400.0)
    assert bridge.engage(True, now_ns=T0).accepted
    assert bridge.engaged(now_ns=T0) is follows


@pytest.mark.parametrize(("throttle", "sent"), [(0.0, 0.0), (0.35, 0.5), (0.7, 1.0), (0.9, 1.0)])
def test_rosflight_scales_the_throttle(new: New, throttle: float, sent: float) -> None:
    bridge = engageable(new)
    frames(bridge, new, rate=400.0)
    assert bridge.engage(True, now_ns=T0).accepted
    message = message_of(bridge.receive_command(command(T0, throttle), now_ns=T0), "/command")
    assert message.u[2] == pytest.approx(sent)

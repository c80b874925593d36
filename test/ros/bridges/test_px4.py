# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""PX4's messages against its documented frames: NED world, FRD body, throttle along -z."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.bridges import (
    AXES,
    FRD,
    HOVER,
    SECOND,
    T0,
    command,
    deliver,
    engage,
    message_of,
    ready_to_fly,
    topics,
)
from fixtures.stack_messages import new_message
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.ros.bridges import px4
from quad_mpc_ros.ros.bridges.bridge import Outgoing
from quad_mpc_ros.ros.bridges.px4 import Px4Bridge

New = Callable[[str], Any]

PX4 = "px4_msgs/msg"
NORTH_ENU, EAST_ENU = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])


def wxyz(axis_angle: list[float]) -> list[float]:
    """Return the quaternion of a rotation vector by the half-angle formula."""
    angle = math.hypot(*axis_angle)
    axis = np.array(axis_angle) / (angle or 1.0)
    return [math.cos(angle / 2.0), *(math.sin(angle / 2.0) * axis)]


def odometry_message(new: New, now_ns: int = 0, **fields: Any) -> Any:
    message = new("px4_msgs/msg/VehicleOdometry")
    message.timestamp = now_ns // 1000
    message.pose_frame, message.velocity_frame = 1, 1
    message.q = [1.0, 0.0, 0.0, 0.0]
    for name, value in fields.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize("axis", AXES)
def test_body_rates_and_body_velocity_axis_by_axis(new: New, axis: tuple[float, ...]) -> None:
    frd = FRD[axis]
    message = odometry_message(new, angular_velocity=frd, velocity=frd, velocity_frame=3)
    odometry = px4.odometry_from_vehicle_odometry(message)
    assert_allclose(odometry.w_WB_B, axis)
    assert_allclose(odometry.v_WB_B, axis)

    rates = new("px4_msgs/msg/VehicleRatesSetpoint")
    px4.fill_vehicle_rates_setpoint(rates, command(w=axis), throttle=0.3)
    assert (rates.roll, rates.pitch, rates.yaw) == frd


def test_the_variance_of_the_velocity_is_passed_on(new: New) -> None:
    message = odometry_message(new, velocity_variance=[0.0625, 0.125, 0.03125])
    assert px4.odometry_from_vehicle_odometry(message).v_variance == 0.125
    message.velocity_variance = [math.nan] * 3
    assert px4.odometry_from_vehicle_odometry(message).v_variance == 0.0


@settings(deadline=None)
@given(
    st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
    st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3),
)
def test_attitude_is_that_of_independently_built_rotations(
    new: New, turn: list[float], velocity: list[float]
) -> None:
    # Columns of the two changes of basis are the axes of the one frame in the other.
    R_enu_ned = np.column_stack((NORTH_ENU, EAST_ENU, -UP))
    R_frd_flu = np.diag([1.0, -1.0, -1.0])
    R_ned_frd = so3.exp(turn)
    message = odometry_message(new, q=wxyz(turn), position=velocity, velocity=velocity)
    odometry = px4.odometry_from_vehicle_odometry(message)
    assert_allclose(odometry.p_WB, R_enu_ned @ velocity, atol=1e-4)
    R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
    assert_allclose(R_WB, R_enu_ned @ R_ned_frd @ R_frd_flu, atol=1e-6)
    v_FRD = R_ned_frd.T @ velocity
    assert_allclose(odometry.v_WB_B, R_frd_flu @ v_FRD, atol=1e-4)


def test_stamp_is_the_time_of_sampling_in_microseconds(new: New) -> None:
    message = odometry_message(new, timestamp=2_000_000, timestamp_sample=1_990_000)
    assert px4.odometry_from_vehicle_odometry(message).stamp_ns == 1_990_000_000
    message = odometry_message(new, timestamp=2_000_000)
    assert px4.odometry_from_vehicle_odometry(message).stamp_ns == 2_000_000_000


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"pose_frame": 0}, "pose_frame 0"),
        ({"pose_frame": 3}, "pose_frame 3"),
        ({"velocity_frame": 0}, "velocity_frame 0"),
        ({"velocity_frame": 2}, "velocity_frame 2 with a pose in NED"),
        ({"pose_frame": 2}, "velocity_frame 1 with a pose in FRD"),
        ({"q": [math.nan, 0.0, 0.0, 0.0]}, "unit quaternion"),
        ({"q": [0.0, 0.0, 0.0, 0.0]}, "unit quaternion"),
    ],
)
def test_unknown_frames_and_no_attitude_are_refused(
    new: New, fields: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        px4.odometry_from_vehicle_odometry(odometry_message(new, **fields))


def made(new: New, **parameters: Any) -> Px4Bridge:
    return Px4Bridge(Px4Bridge.Config(**parameters), new)


@pytest.mark.parametrize(
    ("request_of", "number", "parameters"),
    [
        (lambda bridge: bridge._switch()[0], 176, [1.0, 6.0, 0.0]),
        (lambda bridge: bridge._switch_back(T0).messages[0], 176, [1.0, 4.0, 3.0]),
        (lambda bridge: bridge._arm(True).messages[0], 400, [1.0, 0.0, 0.0]),
        (lambda bridge: bridge._arm(False).messages[0], 400, [0.0, 21196.0, 0.0]),
    ],
)
def test_converts_commands(
    new: New, request_of: Callable[[Px4Bridge], Any], number: int, parameters: list[float]
) -> None:
    message = request_of(made(new, target_system=7)).message
    assert message.command == number
    assert [message.param1, message.param2, message.param3] == parameters
    assert (message.target_system, message.from_external) == (7, True)


def px4_status(new: New, nav_state: int) -> Any:
    message = new("px4_msgs/msg/VehicleStatus")
    message.nav_state = nav_state
    return message


def report_status(
    bridge: Px4Bridge, now_ns: int, *, nav_state: int = 14, armed: bool = True
) -> None:
    """Deliver both messages of PX4 with its mode and arming state."""
    status, mode = px4_status(new_message, nav_state), new_message(f"{PX4}/VehicleControlMode")
    status.arming_state = 2 if armed else 1
    mode.flag_control_offboard_enabled, mode.flag_armed = nav_state == 14, armed
    deliver(bridge, "/fmu/out/vehicle_status_v4", status, now_ns)
    deliver(bridge, "/fmu/out/vehicle_control_mode", mode, now_ns)


def flown(
    bridge: Px4Bridge, begin_ns: int, *, seconds: float, throttle: float = HOVER, **state: Any
) -> list[tuple[int, Outgoing]]:
    """Let PX4 and the MPC speak for a while; return what was sent, and when."""
    sent: list[tuple[int, Outgoing]] = []
    for now_ns in range(begin_ns, begin_ns + round(seconds * SECOND), SECOND // 50):
        deliver(bridge, "/fmu/out/vehicle_odometry", odometry_message(new_message, now_ns), now_ns)
        report_status(bridge, now_ns, **state)
        made = bridge.receive_command(command(now_ns, throttle), now_ns=now_ns)
        sent += [(now_ns, each) for each in made]
    return sent


def names_of(sent: list[tuple[int, Outgoing]]) -> set[str]:
    return set(topics([each for _, each in sent]))


HEARTBEAT, RATES, COMMAND = (
    f"/fmu/in/{name}"
    for name in ("offboard_control_mode", "vehicle_rates_setpoint", "vehicle_command")
)


@pytest.mark.parametrize("nav_state", [0, 2, 4, 10, 13, 15, 17, 18])
def test_sends_heartbeat_without_rates_outside_offboard(new: New, nav_state: int) -> None:
    bridge = made(new)
    assert flown(bridge, T0, seconds=0.1, nav_state=nav_state) == []  # nor a heartbeat unasked
    assert bridge.engage(True, now_ns=T0 + SECOND // 10).accepted
    sent = flown(bridge, T0 + SECOND // 10, seconds=0.5, nav_state=nav_state)
    assert names_of(sent) == {HEARTBEAT}
    assert "not in offboard mode" in bridge.silence


def test_requests_offboard_only_after_a_second_of_heartbeats(new: New) -> None:
    bridge = made(new)
    assert "no vehicle_status" in bridge.engage(True, now_ns=T0).text
    assert bridge.engage(False, now_ns=T0).accepted  # away from the MPC at any time
    flown(bridge, T0, seconds=0.5, nav_state=4)
    begun = T0 + SECOND // 2
    assert bridge.engage(True, now_ns=begun).accepted
    sent = flown(bridge, begun, seconds=2.0, nav_state=4)
    (first, *_) = [now_ns for now_ns, each in sent if topics([each]) == [COMMAND]]
    assert SECOND < first - begun < 1.3 * SECOND
    # Another second later it is asked again, and after five it is given up.
    sent = flown(bridge, begun + 2 * SECOND, seconds=4.0, nav_state=4)
    assert max(now_ns for now_ns, _ in sent) <= begun + 5.1 * SECOND
    assert bridge.handover[0] == "released"
    assert "not switched" in bridge.handover[1]


def test_px4_is_released_by_first_message_of_another_mode(new: New) -> None:
    for message_kind in ("status", "control_mode"):
        bridge = ready_to_fly(Px4Bridge, T0)
        assert bridge.engaged(now_ns=T0)
        if message_kind == "status":
            deliver(bridge, "/fmu/out/vehicle_status_v4", px4_status(new, 2), T0)
        else:
            mode = new(f"{PX4}/VehicleControlMode")
            mode.flag_armed = True
            deliver(bridge, "/fmu/out/vehicle_control_mode", mode, T0)
        assert not bridge.engaged(now_ns=T0)
        assert bridge.receive_command(command(T0), now_ns=T0) == []


def test_sends_no_heartbeat_after_the_mpc_returns(new: New) -> None:
    """PX4's intended mode stays offboard: after one heartbeat it would follow any setpoint."""
    bridge = ready_to_fly(Px4Bridge, T0)
    assert flown(bridge, T0, seconds=1.0)
    back = T0 + 3 * SECOND
    assert flown(bridge, back, seconds=2.0, nav_state=18) == []
    assert flown(bridge, back + 2 * SECOND, seconds=2.0, nav_state=14) == []
    assert "without a fresh command" in bridge.handover[1]
    assert bridge.engage(True, now_ns=back + 4 * SECOND).accepted
    assert names_of(flown(bridge, back + 4 * SECOND, seconds=1.0)) == {HEARTBEAT, RATES}


def test_refuses_arming_into_offboard_after_landing(new: New) -> None:
    bridge = ready_to_fly(Px4Bridge, T0)
    flown(bridge, T0, seconds=1.0)
    down = T0 + SECOND
    assert flown(bridge, down, seconds=1.0, armed=False) == []
    assert "disarming" in bridge.handover[1]
    later = down + SECOND
    assert "engage first" in bridge.arm(True, now_ns=later).text
    land = new(f"{PX4}/VehicleLandDetected")
    land.landed = True
    deliver(bridge, "/fmu/out/vehicle_land_detected", land, later)
    # Engaged on the ground, but the MPC would take off at once, and turn at once.
    assert "of the weight as thrust" in bridge.engage(True, now_ns=later).text
    flown(bridge, later, seconds=0.1, throttle=0.0, armed=False)
    later += SECOND // 10
    assert bridge.engage(True, now_ns=later).accepted
    flown(bridge, later, seconds=1.5, throttle=0.0, armed=False)
    later += round(1.5 * SECOND)
    assert bridge.handover[0] == "standby"
    bridge.receive_command(command(later, 0.0, w=(0.0, 16.0, 0.0)), now_ns=later)
    assert "16.0 rad/s" in bridge.arm(True, now_ns=later).text
    bridge.receive_command(command(later, 0.0), now_ns=later)
    (arming,) = bridge.arm(True, now_ns=later).messages
    assert (arming.message.command, arming.message.param1) == (400, 1.0)
    flown(bridge, later, seconds=0.1, throttle=0.0)
    assert bridge.handover[0] == "engaged"


def test_land_detector_has_priority_over_arming(new: New) -> None:
    bridge = ready_to_fly(Px4Bridge, T0)
    assert bridge.landed(now_ns=T0) is False
    land = new(f"{PX4}/VehicleLandDetected")
    land.landed = True
    deliver(bridge, "/fmu/out/vehicle_land_detected", land, T0)
    assert bridge.landed(now_ns=T0) is True


def test_messages_to_px4_are_not_latched(new: New) -> None:
    assert not any(topic.latched for topic in made(new).publications)


def test_px4_topics_end_in_the_version_of_their_message(new: New) -> None:
    def names(bridge: Px4Bridge) -> set[str]:
        return {each.topic.name for each in bridge.subscriptions} | {
            topic.name for topic in bridge.publications
        }

    assert "/fmu/out/vehicle_status_v4" in names(made(new))
    assert "/fmu/out/vehicle_odometry" in names(made(new))
    assert "/px4_1/fmu/out/vehicle_status_v4" in names(made(new, fmu="/px4_1/fmu"))


def test_names_px4_msgs_of_another_release_if_only_the_status_is_missing(new: New) -> None:
    bridge = made(new)
    mismatch = "px4_msgs is not of the vehicle's PX4 release"

    def fault_after(seconds: float) -> str:
        now_ns = T0 + round(seconds * SECOND)
        deliver(bridge, "/fmu/out/vehicle_odometry", odometry_message(new, now_ns), now_ns)
        deliver(bridge, "/fmu/out/vehicle_control_mode", new(f"{PX4}/VehicleControlMode"), now_ns)
        return bridge.stack_fault(now_ns=now_ns)

    assert "vehicle_status_v4" in fault_after(0.0)
    assert mismatch not in fault_after(1.4)  # PX4 may not have published it yet
    assert mismatch in fault_after(1.6)
    report_status(bridge, T0 + 2 * SECOND)
    assert fault_after(2.1) == ""
    assert "vehicle_status_v4" in fault_after(4.0)  # the link was cut
    assert mismatch not in fault_after(4.0)


@pytest.mark.parametrize("field", ["position", "velocity", "angular_velocity"])
def test_px4_state_marked_invalid_is_not_passed_on(new: New, field: str) -> None:
    bridge = made(new)
    message = odometry_message(new, T0, **{field: [math.nan, 0.0, 0.0]})
    assert deliver(bridge, "/fmu/out/vehicle_odometry", message, T0) is None
    (warning,) = bridge.take_warnings()
    assert "the stack's state is not valid" in warning
    assert "not finite" in warning


def test_px4_frame_changes_are_passed_on_as_a_jump(new: New) -> None:
    bridge = made(new)
    frames = ((1, 1), (2, 2), (2, 3))
    for i, (pose, velocity) in enumerate(frames):
        now_ns = T0 + i * SECOND // 50
        message = odometry_message(new, now_ns, pose_frame=pose, velocity_frame=velocity)
        odometry = deliver(bridge, "/fmu/out/vehicle_odometry", message, now_ns)
        assert odometry is not None
        assert (odometry.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert bridge.jumps == 1


def test_reports_px4_refusals(new: New) -> None:
    bridge = made(new)
    ack = new("px4_msgs/msg/VehicleCommandAck")
    ack.command, ack.result = 400, 1
    deliver(bridge, "/fmu/out/vehicle_command_ack_v1", ack, T0)
    (warning,) = bridge.take_warnings()
    assert "PX4 refuses to arm or disarm (temporarily rejected)" in warning


def test_commands_take_the_newest_battery_into_account(new: New) -> None:
    config = Px4Bridge.Config()
    reference = dataclasses.replace(config.thrust_map, battery_voltage=16.0)
    bridge = Px4Bridge(dataclasses.replace(config, thrust_map=reference), new)
    engage(bridge, T0)
    battery = new("px4_msgs/msg/BatteryStatus")
    battery.voltage_v = 15.0
    deliver(bridge, "/fmu/out/battery_status_v1", battery, T0)
    rates = message_of(bridge.receive_command(command(T0), now_ns=T0), "vehicle_rates_setpoint")
    assert 0.3 < -rates.thrust_body[2] < 0.4

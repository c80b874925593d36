"""PX4's messages against its documented frames: NED world, FRD body, throttle along -z."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.bridges import px4
from quad_mpc_ros.bridges.frames import enu_from_ned, flu_from_frd
from quad_mpc_ros.lie import so3
from quad_mpc_ros.model.samples import CommandSample

New = Callable[[str], Any]

NORTH_ENU, EAST_ENU = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])


def wxyz(axis_angle: list[float]) -> list[float]:
    """Return the quaternion of a rotation vector by the half-angle formula."""
    angle = math.hypot(*axis_angle)
    axis = np.array(axis_angle) / (angle or 1.0)
    return [math.cos(angle / 2.0), *(math.sin(angle / 2.0) * axis)]


def odometry_message(new: New, **fields: Any) -> Any:
    message = new("px4_msgs/msg/VehicleOdometry")
    message.pose_frame, message.velocity_frame = 1, 1
    message.q = [1.0, 0.0, 0.0, 0.0]
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def command(throttle: float = 0.3, w: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
    return CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(w))


@pytest.mark.parametrize(
    ("ned", "enu"),
    [
        ([1, 0, 0], [0, 1, 0]),
        ([-1, 0, 0], [0, -1, 0]),
        ([0, 1, 0], [1, 0, 0]),
        ([0, -1, 0], [-1, 0, 0]),
        ([0, 0, 1], [0, 0, -1]),
        ([0, 0, -1], [0, 0, 1]),
    ],
)
def test_position_and_world_velocity_axis_by_axis(
    new: New, ned: list[float], enu: list[float]
) -> None:
    odometry = px4.odometry_from_vehicle_odometry(
        odometry_message(new, position=ned, velocity=ned)
    )
    assert_allclose(odometry.p_WB, enu)
    R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
    assert_allclose(R_WB @ odometry.v_WB_B, enu, atol=1e-12)


@pytest.mark.parametrize(
    ("frd", "flu"),
    [
        ([1, 0, 0], [1, 0, 0]),
        ([-1, 0, 0], [-1, 0, 0]),
        ([0, 1, 0], [0, -1, 0]),
        ([0, -1, 0], [0, 1, 0]),
        ([0, 0, 1], [0, 0, -1]),
        ([0, 0, -1], [0, 0, 1]),
    ],
)
def test_body_rates_and_body_velocity_axis_by_axis(
    new: New, frd: list[float], flu: list[float]
) -> None:
    message = odometry_message(new, angular_velocity=frd, velocity=frd, velocity_frame=3)
    odometry = px4.odometry_from_vehicle_odometry(message)
    assert_allclose(odometry.w_WB_B, flu)
    assert_allclose(odometry.v_WB_B, flu)

    rates = new("px4_msgs/msg/VehicleRatesSetpoint")
    px4.fill_vehicle_rates_setpoint(rates, command(w=(flu[0], flu[1], flu[2])), throttle=0.3)
    assert [rates.roll, rates.pitch, rates.yaw] == frd


def test_level_and_heading_north_is_a_yaw_of_90_degrees(new: New) -> None:
    odometry = px4.odometry_from_vehicle_odometry(odometry_message(new))
    R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
    assert_allclose(R_WB @ [1.0, 0.0, 0.0], NORTH_ENU, atol=1e-12)
    assert_allclose(R_WB @ [0.0, 0.0, 1.0], UP, atol=1e-12)


def test_heading_east_is_the_identity(new: New) -> None:
    message = odometry_message(new, q=wxyz([0.0, 0.0, math.pi / 2.0]))
    odometry = px4.odometry_from_vehicle_odometry(message)
    R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
    assert_allclose(R_WB, np.eye(3), atol=1e-7)


def test_nose_down_heading_north_accelerates_north(new: New) -> None:
    # FRD: the nose goes down with a negative pitch; the thrust then leans forward.
    message = odometry_message(new, q=wxyz([0.0, -0.3, 0.0]))
    odometry = px4.odometry_from_vehicle_odometry(message)
    thrust_W = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw) @ UP
    assert_allclose(thrust_W, math.sin(0.3) * NORTH_ENU + math.cos(0.3) * UP, atol=1e-7)


def test_rolling_right_heading_north_accelerates_east(new: New) -> None:
    message = odometry_message(new, q=wxyz([0.3, 0.0, 0.0]))
    odometry = px4.odometry_from_vehicle_odometry(message)
    thrust_W = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw) @ UP
    assert_allclose(thrust_W, math.sin(0.3) * EAST_ENU + math.cos(0.3) * UP, atol=1e-7)


def test_a_rate_that_lowers_the_nose_is_a_negative_pitch_rate(new: New) -> None:
    rates = new("px4_msgs/msg/VehicleRatesSetpoint")
    px4.fill_vehicle_rates_setpoint(rates, command(w=(0.0, 1.5, 0.0)), throttle=0.3)
    assert rates.pitch == -1.5


def test_thrust_points_up_which_is_negative(new: New) -> None:
    rates = new("px4_msgs/msg/VehicleRatesSetpoint")
    px4.fill_vehicle_rates_setpoint(rates, command(), throttle=0.25)
    assert rates.thrust_body.tolist() == [0.0, 0.0, -0.25]
    assert rates.timestamp == 0


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
    message = odometry_message(new, q=wxyz(turn), velocity=velocity)
    odometry = px4.odometry_from_vehicle_odometry(message)
    R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
    assert_allclose(R_WB, R_enu_ned @ R_ned_frd @ R_frd_flu, atol=1e-6)
    v_FRD = R_ned_frd.T @ velocity
    assert_allclose(odometry.v_WB_B, R_frd_flu @ v_FRD, atol=1e-4)


@settings(deadline=None)
@given(st.lists(st.floats(-1e4, 1e4), min_size=3, max_size=3))
def test_vectors_there_and_back(values: list[float]) -> None:
    assert_allclose(enu_from_ned(enu_from_ned(values)), values)
    assert_allclose(flu_from_frd(flu_from_frd(values)), values)


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
        ({"q": [math.nan, 0.0, 0.0, 0.0]}, "no rotation"),
        ({"q": [0.0, 0.0, 0.0, 0.0]}, "no rotation"),
    ],
)
def test_unknown_frames_and_no_attitude_are_refused(
    new: New, fields: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        px4.odometry_from_vehicle_odometry(odometry_message(new, **fields))


def test_heartbeat_claims_body_rates_and_nothing_else(new: New) -> None:
    message = new("px4_msgs/msg/OffboardControlMode")
    message.position = True  # as if it had been used before
    px4.fill_offboard_control_mode(message)
    claimed = [name for name in message.FIELDS if getattr(message, name) is True]
    assert claimed == ["body_rate"]
    assert message.timestamp == 0


@pytest.mark.parametrize(
    ("fill", "number", "parameters"),
    [
        (px4.fill_offboard_mode, 176, [1.0, 6.0, 0.0]),
        (px4.fill_hold_mode, 176, [1.0, 4.0, 3.0]),
    ],
)
def test_mode_commands(
    new: New, fill: Callable[..., None], number: int, parameters: list[float]
) -> None:
    message = new("px4_msgs/msg/VehicleCommand")
    fill(message, target_system=7)
    assert message.command == number
    assert [message.param1, message.param2, message.param3] == parameters
    assert (message.target_system, message.from_external) == (7, True)


@pytest.mark.parametrize("wanted", [True, False])
def test_arming_command(new: New, wanted: bool) -> None:
    message = new("px4_msgs/msg/VehicleCommand")
    px4.fill_arming(message, wanted=wanted, target_system=1)
    assert (message.command, message.param1, message.from_external) == (400, float(wanted), True)

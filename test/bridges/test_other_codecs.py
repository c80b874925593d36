"""MAVROS, ROSflight, Aerostack2, Crazyswarm2 and plain rates, against what each documents."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.bridges import (
    aerostack2,
    crazyswarm2,
    mavros,
    rates,
    rosflight,
)
from quad_mpc_ros.bridges.odometry import PoseDifferentiator
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import CommandSample, OdometrySample

New = Callable[[str], Any]

NOW_NS = 5_250_000_000
AXES = [
    (1.0, 0.0, 0.0),
    (-1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, -1.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
]
# Forward stays; left and up become right and down.
FRD = {axis: (axis[0], -axis[1], -axis[2]) for axis in AXES}


def command(w: tuple[float, ...] = (0.0, 0.0, 0.0), throttle: float = 0.3) -> CommandSample:
    return CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(w))


def vector(v: Any) -> tuple[float, float, float]:
    return v.x, v.y, v.z


def set_q(q: Any, R: Array) -> None:
    q.x, q.y, q.z, q.w = (float(value) for value in so3.quaternion_xyzw_from_rotation(R))


@pytest.mark.parametrize("axis", AXES)
def test_mavros_takes_flu_as_it_is(new: New, axis: tuple[float, ...]) -> None:
    message = new("mavros_msgs/msg/AttitudeTarget")
    mavros.fill_attitude_target(message, command(axis), throttle=0.42, now_ns=NOW_NS)
    assert vector(message.body_rate) == axis
    assert message.thrust == pytest.approx(0.42)
    # Ignore the attitude, and none of the rates (1, 2, 4) nor the thrust (64).
    assert message.type_mask == 128
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 250_000_000)


@pytest.mark.parametrize("axis", AXES)
def test_rosflight_takes_frd_behind_three_forces(new: New, axis: tuple[float, ...]) -> None:
    message = new("rosflight_msgs/msg/Command")
    rosflight.fill_command(message, command(axis), throttle=0.5, now_ns=NOW_NS)
    assert message.u.tolist() == [0.0, 0.0, 0.5, *FRD[axis], 0.0, 0.0, 0.0, 0.0]
    assert (message.mode, message.ignore) == (1, 0)


def test_rosflight_of_the_first_releases_names_its_six_values() -> None:
    class Header:
        class stamp:  # noqa: N801
            sec = nanosec = 0

    class First:
        header = Header
        mode = ignore = None
        qx = qy = qz = fx = fy = fz = math.nan

    message: Any = First()
    rosflight.fill_command(message, command((1.0, 2.0, 3.0)), throttle=0.5, now_ns=0)
    assert (message.qx, message.qy, message.qz) == (1.0, -2.0, -3.0)
    assert (message.fx, message.fy, message.fz) == (0.0, 0.0, 0.5)


@pytest.mark.parametrize("kind", ["roscopter_msgs/msg/State", "rosflight_msgs/msg/SimState"])
def test_rosflight_nose_down_heading_north_leans_north(new: New, kind: str) -> None:
    message = new(kind)
    R_ned_frd = so3.exp([0.0, -0.3, 0.0])
    if kind.startswith("roscopter"):
        set_q(message.quat, R_ned_frd)
        message.p_n, message.p_e, message.p_d = 1.0, 2.0, -3.0
        message.v_x, message.v_y, message.v_z = 4.0, 5.0, 6.0
        message.p, message.q, message.r = 0.1, 0.2, 0.3
        odometry = rosflight.odometry_from_state(message)
    else:
        set_q(message.pose.orientation, R_ned_frd)
        p, v, w = message.pose.position, message.twist.linear, message.twist.angular
        p.x, p.y, p.z = 1.0, 2.0, -3.0
        v.x, v.y, v.z = 4.0, 5.0, 6.0
        w.x, w.y, w.z = 0.1, 0.2, 0.3
        odometry = rosflight.odometry_from_sim_state(message)
    assert_allclose(odometry.p_WB, [2.0, 1.0, 3.0])  # east, north, up
    assert_allclose(odometry.v_WB_B, [4.0, -5.0, -6.0])
    assert_allclose(odometry.w_WB_B, [0.1, -0.2, -0.3], rtol=1e-6)
    up_W = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)[:, 2]
    assert_allclose(up_W, [0.0, math.sin(0.3), math.cos(0.3)], atol=1e-12)


def test_rosflight_without_an_attitude_is_refused(new: New) -> None:
    message = new("roscopter_msgs/msg/State")
    message.quat.w = 0.0
    with pytest.raises(ValueError, match="no rotation"):
        rosflight.odometry_from_state(message)


@pytest.mark.parametrize("axis", AXES)
def test_aerostack2_takes_flu_and_newton(new: New, axis: tuple[float, ...]) -> None:
    twist, thrust = new("geometry_msgs/msg/TwistStamped"), new("as2_msgs/msg/Thrust")
    aerostack2.fill_body_rates(twist, command(axis), frame_id="drone0/base_link", now_ns=NOW_NS)
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
def test_aerostack2_turns_a_twist_of_the_world(new: New, frame: str, v_B: list[float]) -> None:
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
def test_crazyswarm2_takes_degrees_in_the_old_frame(
    new: New, w: tuple[float, ...], field: str, degrees: float
) -> None:
    message = new("geometry_msgs/msg/Twist")
    crazyswarm2.fill_setpoint(message, command(w), throttle=0.5)
    part, name = field.split(".")
    assert getattr(getattr(message, part), name) == pytest.approx(degrees)
    others = {"linear.x", "linear.y", "angular.x", "angular.y", "angular.z"} - {field}
    assert all(getattr(getattr(message, f.split(".")[0]), f[-1]) == 0.0 for f in others)


@pytest.mark.parametrize(
    ("throttle", "pwm"), [(0.0, 0.0), (0.5, 32767.5), (0.9, 58981.5), (1.0, 60000.0)]
)
def test_crazyswarm2_takes_thrust_in_pwm_and_cuts_it(
    new: New, throttle: float, pwm: float
) -> None:
    message = new("geometry_msgs/msg/Twist")
    crazyswarm2.fill_setpoint(message, command(), throttle=throttle)
    assert message.linear.z == pytest.approx(pwm)


def test_crazyswarm2_gives_its_velocity_in_the_world(new: New) -> None:
    message = new("nav_msgs/msg/Odometry")
    set_q(message.pose.pose.orientation, so3.exp([0.0, 0.0, math.pi / 2.0]))
    message.twist.twist.linear.y = 2.0  # north, which is ahead
    assert_allclose(crazyswarm2.odometry_from_odom(message).v_WB_B, [2.0, 0.0, 0.0], atol=1e-12)


def poses_of_a_turn(w_WB_B: Array, v_WB_W: Array) -> list[OdometrySample]:
    return [
        OdometrySample(
            stamp_ns=i * 10_000_000,
            p_WB=0.01 * i * v_WB_W,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(
                so3.exp([0.0, 0.0, 3.0]) @ so3.exp(0.01 * i * w_WB_B)
            ),
            v_WB_B=np.zeros(3),
            w_WB_B=np.zeros(3),
        )
        for i in range(80)
    ]


@pytest.mark.parametrize("axis", AXES)
def test_poses_of_a_steady_turn_give_its_rates_and_velocity(axis: tuple[float, ...]) -> None:
    w_WB_B, v_WB_W = 4.0 * np.array(axis), np.array([1.0, -2.0, 0.5])
    differentiator = PoseDifferentiator(velocity_too=True)
    found = [differentiator.completed(pose) for pose in poses_of_a_turn(w_WB_B, v_WB_W)]
    assert found[0] is None
    for odometry in found[1:]:  # through the double cover of quaternions as well
        assert odometry is not None
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        assert_allclose(odometry.w_WB_B, w_WB_B, atol=1e-6)
        assert_allclose(R_WB @ odometry.v_WB_B, v_WB_W, atol=1e-6)


def test_a_step_of_the_position_is_no_velocity() -> None:
    still, stepped = poses_of_a_turn(np.zeros(3), np.zeros(3))[:2]
    differentiator = PoseDifferentiator(velocity_too=True)
    differentiator.completed(still)
    object.__setattr__(stepped, "p_WB", np.array([3.0, 0.0, 0.0]))
    odometry = differentiator.completed(stepped)
    assert odometry is not None
    assert_allclose(odometry.v_WB_B, np.zeros(3))


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(("angle_unit", "scale"), [("rad", 1.0), ("deg", 180.0 / math.pi)])
@pytest.mark.parametrize("body_frame", ["flu", "frd"])
def test_rates_in_every_frame_and_unit(
    new: New, axis: tuple[float, ...], angle_unit: str, scale: float, body_frame: str
) -> None:
    message = new("geometry_msgs/msg/TwistStamped")
    rates.fill_rates(
        message,
        command(axis),
        thrust=4.0,
        body_frame=body_frame,
        angle_unit=angle_unit,
        frame_id="base_link",
        now_ns=NOW_NS,
    )
    expected = axis if body_frame == "flu" else FRD[axis]
    assert_allclose(vector(message.twist.angular), scale * np.array(expected))
    assert message.twist.linear.z == (4.0 if body_frame == "flu" else -4.0)

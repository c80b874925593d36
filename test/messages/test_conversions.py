# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages and values: nothing lost, every field in its place."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.ros.messages import new_message


def test_velocity_variance_survives_the_message() -> None:
    message = new_message("nav_msgs/msg/Odometry")
    sample = dataclasses.replace(OdometrySample.at_rest([0.0, 0.0, 1.0]), v_variance=0.1)
    conversions.fill_odometry(message, sample)
    assert conversions.odometry_from_message(message).v_variance == 0.1
    message.twist.covariance[7] = 0.3  # the axes differ: the largest counts
    assert conversions.odometry_from_message(message).v_variance == 0.3


def test_estimate_reset_is_the_transform_of_the_former_frame() -> None:
    message = new_message("geometry_msgs/msg/TransformStamped")
    reset = EstimateReset(
        stamp_ns=12_000_000_345, turn=2.0, step_W=np.array([1.0, 2.0, 3.0]), frame_id="map"
    )
    conversions.fill_reset(message, reset)
    assert (message.header.frame_id, message.child_frame_id) == ("map", "map_before")
    q = message.transform.rotation
    p_W = np.array([0.3, -0.7, 0.1])
    # As tf2 transforms a point of the child's frame.
    there = so3.rotation_from_quaternion_xyzw(np.array([q.x, q.y, q.z, q.w])) @ p_W + [1, 2, 3]
    assert np.allclose(reset.points(p_W), there)
    again = conversions.reset_from_message(message)
    assert (again.stamp_ns, again.frame_id) == (reset.stamp_ns, "map")
    assert again.turn == pytest.approx(2.0)
    assert np.array_equal(again.step_W, reset.step_W)
    q.x = 0.1
    with pytest.raises(ValueError, match="a rotation about the vertical"):
        conversions.reset_from_message(message)


@pytest.mark.parametrize("nothing", [0.0, -1.0, math.nan, math.inf, 1e6])
def test_unusable_covariance_gives_no_variance(nothing: float) -> None:
    message = new_message("nav_msgs/msg/Odometry")
    message.twist.covariance[0] = message.twist.covariance[7] = 0.1
    message.twist.covariance[14] = nothing
    assert conversions.odometry_from_message(message).v_variance == 0.0


def test_command_is_throttle_in_linear_z_and_rates_in_angular() -> None:
    message = new_message("geometry_msgs/msg/TwistStamped")
    command = CommandSample(stamp_ns=7, throttle=0.3, w_WB_B=np.array([1.0, -2.0, 3.0]))

    conversions.fill_command(message, command)

    assert message.twist.linear.z == 0.3
    assert (message.twist.linear.x, message.twist.linear.y) == (0.0, 0.0)
    angular = message.twist.angular
    assert (angular.x, angular.y, angular.z) == (1.0, -2.0, 3.0)
    _assert_same(conversions.command_from_message(message), command)


def test_reference_without_derivatives() -> None:
    message = new_message("trajectory_msgs/msg/MultiDOFJointTrajectory")
    point = new_message("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")
    point.transforms = [new_message("geometry_msgs/msg/Transform")]
    message.points = [point]

    window = conversions.reference_from_message(message)

    assert not window.v_WB_W.any()
    assert not window.a_WB_W.any()
    point.transforms = []
    with pytest.raises(ValueError, match="point 0 of the reference has no transform"):
        conversions.reference_from_message(message)


def _assert_same(a: object, b: object) -> None:
    for name, value in vars(b).items():
        np.testing.assert_array_equal(getattr(a, name), value, err_msg=name)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Conversions between ROS messages and the types of this package.

A function reads the attributes of a message, or fills a given message, and imports no message
package. So the same code serves rclpy's messages and messages of a bag read without ROS. ``new``
creates an empty message of a type, for the elements of sequences.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.lie.formulas import heading
from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
    reported_variance,
)
from quad_mpc_ros.control.safety.validation import is_frame
from quad_mpc_ros.messages import cdr

if TYPE_CHECKING:
    from quad_mpc_ros.control.model.estimate_reset import EstimateReset
    from quad_mpc_ros.control.ocp.plan import Plan

NewMessage = Callable[[str], Any]
"""Creates an empty message of a type named like ``geometry_msgs/msg/Pose``."""

_SECOND = 1_000_000_000
_YAW_TOLERANCE = 1e-3  # of a quaternion about the vertical
_VELOCITY_VARIANCES = (0, 7, 14)  # of a twist's covariance (36,), row by row

_COLUMNS = (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13), slice(13, 16))
_ZERO_VECTOR = SimpleNamespace(x=0.0, y=0.0, z=0.0)


def nanoseconds(time: Any) -> int:
    """Return a ``builtin_interfaces`` Time or Duration in nanoseconds."""
    return int(time.sec) * _SECOND + int(time.nanosec)


def fill_time(time: Any, stamp_ns: int) -> None:
    """Write nanoseconds into a ``builtin_interfaces`` Time or Duration."""
    time.sec, time.nanosec = divmod(stamp_ns, _SECOND)


def odometry_from_message(message: Any) -> OdometrySample:
    """Return the values of a ``nav_msgs/Odometry``, unchecked."""
    placed = SimpleNamespace(header=message.header, pose=message.pose.pose)
    odometry = odometry_from_pose_and_twist(
        placed, message.twist, child_frame_id=message.child_frame_id
    )
    covariance = message.twist.covariance
    variance = reported_variance([covariance[place] for place in _VELOCITY_VARIANCES])
    return odometry if variance == 0.0 else replace(odometry, v_variance=variance)


def odometry_from_pose_and_twist(pose: Any, twist: Any, *, child_frame_id: str) -> OdometrySample:
    """Return the values of a ``PoseStamped`` and a ``TwistStamped``, with the pose's stamp."""
    return OdometrySample(
        stamp_ns=nanoseconds(pose.header.stamp),
        frame_id=pose.header.frame_id,
        child_frame_id=child_frame_id,
        p_WB=vector(pose.pose.position),
        q_WB_xyzw=quaternion(pose.pose.orientation),
        v_WB_B=vector(twist.twist.linear),
        w_WB_B=vector(twist.twist.angular),
    )


def fill_odometry(message: Any, odometry: OdometrySample) -> None:
    """Write an odometry into a ``nav_msgs/Odometry``."""
    fill_header(message.header, odometry.stamp_ns, odometry.frame_id)
    message.child_frame_id = odometry.child_frame_id
    fill_vector(message.pose.pose.position, odometry.p_WB.tolist())
    fill_quaternion(message.pose.pose.orientation, odometry.q_WB_xyzw.tolist())
    fill_vector(message.twist.twist.linear, odometry.v_WB_B.tolist())
    fill_vector(message.twist.twist.angular, odometry.w_WB_B.tolist())
    for place in _VELOCITY_VARIANCES:
        message.twist.covariance[place] = odometry.v_variance


def imu_from_message(message: Any) -> ImuSample:
    """Return the specific force of a ``sensor_msgs/Imu``, unchecked.

    Raises ``ValueError`` for a message without acceleration.
    """
    if message.linear_acceleration_covariance[0] == cdr.NOT_MEASURED:
        raise ValueError("imu has no acceleration: its covariance begins with -1")
    return ImuSample(
        stamp_ns=nanoseconds(message.header.stamp),
        f_B=vector(message.linear_acceleration),
        frame_id=message.header.frame_id,
    )


def command_from_message(message: Any) -> CommandSample:
    """Return the values of a ``geometry_msgs/TwistStamped`` command."""
    return CommandSample(
        stamp_ns=nanoseconds(message.header.stamp),
        frame_id=message.header.frame_id,
        throttle=float(message.twist.linear.z),
        w_WB_B=vector(message.twist.angular),
    )


def fill_command(message: Any, command: CommandSample) -> None:
    """Write a command into a ``geometry_msgs/TwistStamped``: throttle in linear.z."""
    fill_header(message.header, command.stamp_ns, command.frame_id)
    message.twist.linear.z = command.throttle
    fill_vector(message.twist.angular, command.w_WB_B.tolist())


def reference_from_message(message: Any) -> ReferenceWindow:
    """Return the values of a ``trajectory_msgs/MultiDOFJointTrajectory``.

    Missing velocities and accelerations of a point are zero. Raises ``ValueError`` for a point
    without a transform.
    """
    rows, offset_ns = [], []
    for i, point in enumerate(message.points):
        if len(point.transforms) == 0:
            raise ValueError(f"point {i} of the reference has no transform")
        offset_ns.append(nanoseconds(point.time_from_start))
        transform, v, w, a = point.transforms[0], _ZERO_VECTOR, _ZERO_VECTOR, _ZERO_VECTOR
        p, q = transform.translation, transform.rotation
        if len(point.velocities) > 0:
            v, w = point.velocities[0].linear, point.velocities[0].angular
        if len(point.accelerations) > 0:
            a = point.accelerations[0].linear
        rows.append(
            (p.x, p.y, p.z, q.x, q.y, q.z, q.w, v.x, v.y, v.z, w.x, w.y, w.z, a.x, a.y, a.z)
        )
    # One array of them all: sixteen small ones per point would take most of the time.
    values = np.array(rows, dtype=np.float64).reshape(-1, 16)
    p_WB, q_WB_xyzw, v_WB_W, w_WB_W, a_WB_W = (
        np.ascontiguousarray(values[:, columns]) for columns in _COLUMNS
    )
    return ReferenceWindow(
        stamp_ns=nanoseconds(message.header.stamp),
        frame_id=message.header.frame_id,
        offset_ns=np.array(offset_ns, dtype=np.int64),
        p_WB=p_WB,
        q_WB_xyzw=q_WB_xyzw,
        v_WB_W=v_WB_W,
        a_WB_W=a_WB_W,
        w_WB_W=w_WB_W,
    )


def ground_state_from_message(message: Any) -> GroundState:
    """Return the state in a ``std_msgs/String``; ``UNKNOWN`` for other text."""
    try:
        return GroundState(message.data)
    except ValueError:
        return GroundState.UNKNOWN


def pose_from_message(message: Any) -> tuple[str, NDArray[np.float64], NDArray[np.float64]]:
    """Return frame, position (3,) and quaternion (4,) of a ``geometry_msgs/PoseStamped``."""
    pose = message.pose
    return message.header.frame_id, vector(pose.position), quaternion(pose.orientation)


def poses_from_message(
    message: Any, *, frame_id: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions (n, 3) and quaternions (n, 4) of a ``geometry_msgs/PoseArray``.

    Raises :class:`.UserError` for a frame other than ``frame_id``.
    """
    if not is_frame(message.header.frame_id, frame_id):
        given = message.header.frame_id
        raise UserError(f"gates are in frame '{given}', expected '{frame_id}'")
    positions = [vector(pose.position) for pose in message.poses]
    quaternions = [quaternion(pose.orientation) for pose in message.poses]
    return np.array(positions).reshape(-1, 3), np.array(quaternions).reshape(-1, 4)


def twist_from_message(message: Any) -> tuple[str, NDArray[np.float64], NDArray[np.float64]]:
    """Return frame, linear and angular velocity (3,) of a ``geometry_msgs/TwistStamped``."""
    twist = message.twist
    return message.header.frame_id, vector(twist.linear), vector(twist.angular)


def positions_from_path(message: Any) -> NDArray[np.float64]:
    """Return the positions (n, 3) of a ``nav_msgs/Path``."""
    places = [vector(pose.pose.position) for pose in message.poses]
    return np.array(places, dtype=np.float64).reshape(-1, 3)


def written_plan(plan: Plan, *, frame_id: str) -> bytes:
    """Return the poses of a plan as the bytes of a ``nav_msgs/Path``."""
    from quad_mpc_ros.control.lie import so3  # compiled: the recorder does without

    return cdr.written_path(
        stamp_ns=plan.stamp_ns,
        step_ns=round(plan.step * 1e9),
        frame_id=frame_id,
        p_WB=plan.p_WB,
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(plan.R_WB),
    )


def fill_transform(message: Any, odometry: OdometrySample, *, new: NewMessage) -> None:
    """Write the pose of an odometry into a ``tf2_msgs/TFMessage``, from parent to child frame."""
    stamped = new("geometry_msgs/msg/TransformStamped")
    fill_header(stamped.header, odometry.stamp_ns, odometry.frame_id)
    stamped.child_frame_id = odometry.child_frame_id
    fill_vector(stamped.transform.translation, odometry.p_WB.tolist())
    fill_quaternion(stamped.transform.rotation, odometry.q_WB_xyzw.tolist())
    message.transforms = [stamped]


def reset_from_message(message: Any) -> EstimateReset:
    """Return an odometry jump from a ``geometry_msgs/TransformStamped``.

    Raises:
        ValueError: Not finite, or not a rotation about the vertical.
    """
    from quad_mpc_ros.control.model.estimate_reset import (
        EstimateReset,  # which needs compiled code
    )

    step_W = vector(message.transform.translation)
    x, y, z, w = quaternion(message.transform.rotation).tolist()
    vertical = math.hypot(x, y) < _YAW_TOLERANCE and abs(math.hypot(z, w) - 1.0) < _YAW_TOLERANCE
    if not (vertical and np.all(np.isfinite(step_W))):
        raise ValueError(
            f"an odometry jump of {step_W.tolist()} m and quaternion {[x, y, z, w]}, expected "
            "finite numbers and a rotation about the vertical"
        )
    return EstimateReset(
        stamp_ns=nanoseconds(message.header.stamp),
        turn=heading((x, y, z, w)),
        step_W=step_W,
        frame_id=str(message.header.frame_id),
    )


def parameter_changes_from_message(message: Any) -> tuple[str, dict[str, Any]]:
    """Return the node of a ``rcl_interfaces/ParameterEvent`` and the changed values, by name.

    Parameters that were only declared are omitted.
    """
    values = {}
    for parameter in message.changed_parameters:
        if field := _PARAMETER_FIELDS[parameter.value.type]:
            value = getattr(parameter.value, field)
            values[str(parameter.name)] = value.tolist() if hasattr(value, "tolist") else value
    return str(message.node), values


_PARAMETER_FIELDS = (
    *("", "bool_value", "integer_value", "double_value", "string_value"),
    *("byte_array_value", "bool_array_value", "integer_array_value"),
    *("double_array_value", "string_array_value"),
)
"""The field of a ``rcl_interfaces/ParameterValue`` with the value, by its type; 0 is not set."""


def fill_reset(message: Any, reset: EstimateReset) -> None:
    """Write an odometry jump into a ``geometry_msgs/TransformStamped``."""
    fill_header(message.header, reset.stamp_ns, reset.frame_id)
    message.child_frame_id = f"{reset.frame_id}_before"
    fill_vector(message.transform.translation, reset.step_W.tolist())
    half = 0.5 * reset.turn
    fill_quaternion(message.transform.rotation, (0.0, 0.0, math.sin(half), math.cos(half)))


def fill_header(header: Any, stamp_ns: int, frame_id: str) -> None:
    """Write into a ``std_msgs/Header``."""
    fill_time(header.stamp, stamp_ns)
    header.frame_id = frame_id


def vector(v: Any) -> NDArray[np.float64]:
    """Return x, y and z of a message (3,)."""
    return np.array((v.x, v.y, v.z))


def quaternion(q: Any) -> NDArray[np.float64]:
    """Return a ``geometry_msgs/Quaternion`` as x, y, z and w (4,)."""
    return np.array((q.x, q.y, q.z, q.w))


def fill_vector(target: Any, values: Iterable[float]) -> None:
    """Write into a message with x, y and z."""
    target.x, target.y, target.z = values


def fill_quaternion(target: Any, q_xyzw: Iterable[float]) -> None:
    """Write into a ``geometry_msgs/Quaternion``."""
    target.x, target.y, target.z, target.w = q_xyzw

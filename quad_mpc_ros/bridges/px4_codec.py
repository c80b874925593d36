"""The messages of PX4 over uXRCE-DDS (px4_msgs), NED and FRD.

Fields and constants after the definitions in https://github.com/PX4/px4_msgs.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from quad_mpc_ros.bridges.frames import (
    enu_from_ned,
    flu_from_frd,
    q_enu_flu_xyzw_from_ned_frd_wxyz,
)
from quad_mpc_ros.lie import so3
from quad_mpc_ros.model.samples import CommandSample, OdometrySample

POSE_FRAME_NED, POSE_FRAME_FRD = 1, 2
VELOCITY_FRAME_NED, VELOCITY_FRAME_FRD, VELOCITY_FRAME_BODY_FRD = 1, 2, 3
NAVIGATION_STATE_OFFBOARD = 14
ARMING_STATE_ARMED = 2

VEHICLE_CMD_DO_SET_MODE = 176
VEHICLE_CMD_COMPONENT_ARM_DISARM = 400
_CUSTOM_MODE_ENABLED = 1.0
_MAIN_MODE_AUTO, _MAIN_MODE_OFFBOARD = 4.0, 6.0
_SUB_MODE_LOITER = 3.0

_POSE_FRAMES = {POSE_FRAME_NED: "NED", POSE_FRAME_FRD: "FRD"}


def odometry_from_vehicle_odometry(message: Any) -> OdometrySample:
    """Return the values of a ``VehicleOdometry``, stamped with its time of sampling.

    Raises ``ValueError`` for a frame that is unknown, for a velocity in another world frame than
    the pose, and for an attitude marked as invalid. Other invalid fields stay NaN.
    """
    pose_frame, velocity_frame = int(message.pose_frame), int(message.velocity_frame)
    if pose_frame not in _POSE_FRAMES:
        raise ValueError(f"pose_frame {pose_frame}, expected 1 (NED) or 2 (FRD)")
    q_WB_xyzw = q_enu_flu_xyzw_from_ned_frd_wxyz(message.q)
    if velocity_frame == VELOCITY_FRAME_BODY_FRD:
        v_WB_B = flu_from_frd(message.velocity)
    elif velocity_frame == pose_frame:
        v_WB_B = so3.rotation_from_quaternion_xyzw(q_WB_xyzw).T @ enu_from_ned(message.velocity)
    else:
        raise ValueError(
            f"velocity_frame {velocity_frame} with a pose in {_POSE_FRAMES[pose_frame]}, "
            f"expected {pose_frame} or 3 (body FRD)"
        )
    return OdometrySample(
        stamp_ns=1000 * int(message.timestamp_sample or message.timestamp),
        p_WB=enu_from_ned(message.position),
        q_WB_xyzw=q_WB_xyzw,
        v_WB_B=v_WB_B,
        w_WB_B=flu_from_frd(message.angular_velocity),
    )


def fill_offboard_control_mode(message: Any) -> None:
    """Write the heartbeat of a controller that commands body rates.

    The timestamp stays 0: PX4 puts its own.
    """
    message.timestamp = 0
    for field in (
        "position",
        "velocity",
        "acceleration",
        "attitude",
        "thrust_and_torque",
        "direct_actuator",
    ):
        setattr(message, field, False)
    message.body_rate = True


def fill_vehicle_rates_setpoint(message: Any, command: CommandSample, *, throttle: float) -> None:
    """Write body rates [rad/s] into a ``VehicleRatesSetpoint`` (FRD), throttle along -z."""
    p, q, r = flu_from_frd(command.w_WB_B).tolist()
    message.timestamp = 0
    message.roll, message.pitch, message.yaw = p, q, r
    message.thrust_body = np.array((0.0, 0.0, -throttle), dtype=np.float32)
    message.reset_integral = False


def fill_arming(message: Any, *, wanted: bool, target_system: int) -> None:
    """Write a ``VehicleCommand`` that arms or disarms."""
    _fill_command(
        message, VEHICLE_CMD_COMPONENT_ARM_DISARM, (float(wanted), 0.0, 0.0), target_system
    )


def fill_offboard_mode(message: Any, *, target_system: int) -> None:
    """Write a ``VehicleCommand`` that switches to offboard mode."""
    parameters = (_CUSTOM_MODE_ENABLED, _MAIN_MODE_OFFBOARD, 0.0)
    _fill_command(message, VEHICLE_CMD_DO_SET_MODE, parameters, target_system)


def fill_hold_mode(message: Any, *, target_system: int) -> None:
    """Write a ``VehicleCommand`` that switches to hold."""
    parameters = (_CUSTOM_MODE_ENABLED, _MAIN_MODE_AUTO, _SUB_MODE_LOITER)
    _fill_command(message, VEHICLE_CMD_DO_SET_MODE, parameters, target_system)


def _fill_command(
    message: Any, command: int, parameters: tuple[float, float, float], target_system: int
) -> None:
    message.timestamp = 0
    message.command = command
    message.param1, message.param2, message.param3 = parameters
    message.target_system, message.target_component = target_system, 1
    message.source_system, message.source_component = 1, 1
    message.from_external = True

"""The messages of Aerostack2 (as2_msgs, geometry_msgs), ENU and FLU.

Fields and constants after https://github.com/aerostack2/aerostack2 (as2_msgs).
"""

from __future__ import annotations

from typing import Any

from quad_mpc_ros.messages.conversions import fill_time, odometry_from_pose_and_twist
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.model.state import with_body_twist

# ACRO until August 2026, BODY_RATES since: the number stayed.
CONTROL_MODE_BODY_RATES = 6
YAW_MODE_YAW_SPEED = 2
BODY_FRAME = "base_link"
_WORLD_FRAMES = ("earth", "map", "odom")


def odometry_from_self_localization(pose: Any, twist: Any) -> OdometrySample:
    """Return the values of a ``PoseStamped`` and the ``TwistStamped`` of the same time.

    Frames may have the vehicle's namespace in front. Raises ``ValueError`` for a twist in neither
    the body nor a world frame.
    """
    odometry = odometry_from_pose_and_twist(pose, twist, child_frame_id=BODY_FRAME)
    frame = str(twist.header.frame_id).rsplit("/", 1)[-1]
    if frame == BODY_FRAME:
        return odometry
    if frame not in _WORLD_FRAMES:
        raise ValueError(
            f"the twist is in frame {twist.header.frame_id!r}, expected {BODY_FRAME} or one of "
            f"{', '.join(_WORLD_FRAMES)}"
        )
    return with_body_twist(odometry)


def fill_thrust(
    message: Any, *, thrust_newton: float, throttle: float, frame_id: str, now_ns: int
) -> None:
    """Write a thrust [N] into an ``as2_msgs/Thrust``, and the throttle where it has a field."""
    fill_time(message.header.stamp, now_ns)
    message.header.frame_id = frame_id
    message.thrust = thrust_newton
    if hasattr(message, "thrust_normalized"):
        message.thrust_normalized = throttle


def fill_body_rates(message: Any, command: CommandSample, *, frame_id: str, now_ns: int) -> None:
    """Write body rates [rad/s, FLU] into a ``TwistStamped``."""
    fill_time(message.header.stamp, now_ns)
    message.header.frame_id = frame_id
    angular = message.twist.angular
    angular.x, angular.y, angular.z = command.w_WB_B.tolist()


def fill_control_mode(request: Any) -> None:
    """Write the mode of body rates into a request of ``SetControlMode``."""
    request.control_mode.control_mode = CONTROL_MODE_BODY_RATES
    request.control_mode.yaw_mode = YAW_MODE_YAW_SPEED

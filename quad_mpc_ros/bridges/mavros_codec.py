"""The messages of MAVROS (mavros_msgs), ENU and FLU: MAVROS converts to the autopilot's frames.

Fields and constants after https://github.com/mavlink/mavros (mavros_msgs/msg/AttitudeTarget).
"""

from __future__ import annotations

from typing import Any

from quad_mpc_ros.messages.conversions import fill_time
from quad_mpc_ros.model.samples import CommandSample

IGNORE_ATTITUDE = 128  # and no bit of a rate or of the thrust


def fill_attitude_target(
    message: Any, command: CommandSample, *, throttle: float, now_ns: int
) -> None:
    """Write body rates [rad/s, FLU] and throttle [0, 1] into an ``AttitudeTarget``."""
    fill_time(message.header.stamp, now_ns)
    message.header.frame_id = command.frame_id
    message.type_mask = IGNORE_ATTITUDE
    p, q, r = command.w_WB_B.tolist()
    message.body_rate.x, message.body_rate.y, message.body_rate.z = p, q, r
    message.thrust = throttle

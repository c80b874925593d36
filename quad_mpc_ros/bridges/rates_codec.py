"""Body rates and thrust in a ``geometry_msgs/TwistStamped``, in whatever units a stack wants."""

from __future__ import annotations

import math
from typing import Any

from quad_mpc_ros.bridges.frames import flu_from_frd
from quad_mpc_ros.messages.conversions import fill_time
from quad_mpc_ros.model.samples import CommandSample


def fill_rates(
    message: Any,
    command: CommandSample,
    *,
    thrust: float,
    body_frame: str,
    angle_unit: str,
    frame_id: str,
    now_ns: int,
) -> None:
    """Write the rates into ``twist.angular`` and the thrust along body z into ``twist.linear.z``.

    ``thrust`` is what shall push the vehicle up, in the stack's unit: along z in ``flu``, against
    it, and so negative, in ``frd``. ``angle_unit`` is ``rad`` or ``deg``.
    """
    frd = body_frame == "frd"
    rates = flu_from_frd(command.w_WB_B) if frd else command.w_WB_B
    scale = math.degrees(1.0) if angle_unit == "deg" else 1.0
    fill_time(message.header.stamp, now_ns)
    message.header.frame_id = frame_id
    angular = message.twist.angular
    angular.x, angular.y, angular.z = (scale * rates).tolist()
    message.twist.linear.z = -thrust if frd else thrust

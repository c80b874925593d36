"""The messages of ROSflight (rosflight_msgs, roscopter_msgs), NED and FRD.

Fields and constants after https://github.com/rosflight/rosflight_ros_pkgs (rosflight_msgs) and
https://github.com/rosflight/roscopter (roscopter_msgs/msg/State).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from quad_mpc_ros.bridges.frames import (
    enu_from_ned,
    flu_from_frd,
    q_enu_flu_xyzw_from_ned_frd_wxyz,
)
from quad_mpc_ros.messages.conversions import fill_time, nanoseconds
from quad_mpc_ros.model.samples import CommandSample, OdometrySample

MODE_ROLLRATE_PITCHRATE_YAWRATE_THROTTLE = 1
IGNORE_NONE = 0
_VALUES = 10
_THROTTLE, _RATES = 2, slice(3, 6)  # u = Fx, Fy, Fz, Qx, Qy, Qz, …; Fz is the throttle


def odometry_from_state(message: Any) -> OdometrySample:
    """Return the values of a ``roscopter_msgs/State``: NED position, body velocity, FRD.

    Raises ``ValueError`` for a quaternion without a rotation.
    """
    q = message.quat
    return OdometrySample(
        stamp_ns=nanoseconds(message.header.stamp),
        p_WB=enu_from_ned((message.p_n, message.p_e, message.p_d)),
        q_WB_xyzw=q_enu_flu_xyzw_from_ned_frd_wxyz((q.w, q.x, q.y, q.z)),
        v_WB_B=flu_from_frd((message.v_x, message.v_y, message.v_z)),
        w_WB_B=flu_from_frd((message.p, message.q, message.r)),
    )


def odometry_from_sim_state(message: Any) -> OdometrySample:
    """Return the values of a ``rosflight_msgs/SimState``, the simulator's truth in NED, FRD.

    Raises ``ValueError`` for a quaternion without a rotation.
    """
    p, q = message.pose.position, message.pose.orientation
    v, w = message.twist.linear, message.twist.angular
    return OdometrySample(
        stamp_ns=nanoseconds(message.header.stamp),
        p_WB=enu_from_ned((p.x, p.y, p.z)),
        q_WB_xyzw=q_enu_flu_xyzw_from_ned_frd_wxyz((q.w, q.x, q.y, q.z)),
        v_WB_B=flu_from_frd((v.x, v.y, v.z)),
        w_WB_B=flu_from_frd((w.x, w.y, w.z)),
    )


def fill_command(message: Any, command: CommandSample, *, throttle: float, now_ns: int) -> None:
    """Write throttle [0, 1] and body rates [rad/s, FRD] into a ``rosflight_msgs/Command``."""
    fill_time(message.header.stamp, now_ns)
    message.mode = MODE_ROLLRATE_PITCHRATE_YAWRATE_THROTTLE
    message.ignore = IGNORE_NONE
    rates_frd = flu_from_frd(command.w_WB_B)
    if hasattr(message, "u"):
        u = np.zeros(_VALUES, dtype=np.float32)
        u[_THROTTLE] = throttle
        u[_RATES] = rates_frd
        message.u = u
    else:  # the first releases of ROSflight 2, and its documentation
        message.qx, message.qy, message.qz = rates_frd.tolist()
        message.fx, message.fy, message.fz = 0.0, 0.0, throttle

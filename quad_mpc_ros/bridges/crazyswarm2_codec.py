"""The messages of Crazyswarm2 (geometry_msgs, nav_msgs).

``cmd_vel_legacy`` carries the four numbers of the Crazyflie's oldest setpoint. The server negates
linear.x to its pitch, and the firmware counts pitch nose-up and, in this setpoint alone, yaw
clockwise: https://imrclab.github.io/crazyswarm2 and
https://www.bitcraze.io/documentation/repository/crazyflie-firmware/master (commanders).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from quad_mpc_ros.messages.conversions import nanoseconds, odometry_from_message
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.model.state import with_body_twist

PWM_FULL = 65535.0
PWM_LARGEST = 60000.0  # where the server cuts
SUPERVISOR_IS_ARMED = 2
SUPERVISOR_IS_TUMBLED = 32
SUPERVISOR_IS_LOCKED = 64


def odometry_from_odom(message: Any) -> OdometrySample:
    """Return the values of the server's ``odom``: linear velocity in the world, no body rates.

    Raises ``ValueError`` for a quaternion without a rotation.
    """
    odometry = with_body_twist(odometry_from_message(message))
    return dataclasses.replace(odometry, w_WB_B=np.zeros(3))


def odometry_from_pose(message: Any) -> OdometrySample:
    """Return the values of the server's ``pose``, a ``PoseStamped``, at rest."""
    p, q = message.pose.position, message.pose.orientation
    return OdometrySample(
        stamp_ns=nanoseconds(message.header.stamp),
        p_WB=np.array((p.x, p.y, p.z)),
        q_WB_xyzw=np.array((q.x, q.y, q.z, q.w)),
        v_WB_B=np.zeros(3),
        w_WB_B=np.zeros(3),
    )


def fill_setpoint(message: Any, command: CommandSample, *, throttle: float) -> None:
    """Write body rates [deg/s] and throttle [PWM] into the ``Twist`` of ``cmd_vel_legacy``."""
    p, q, r = (math.degrees(rate) for rate in command.w_WB_B.tolist())
    message.linear.x, message.linear.y = q, p
    message.linear.z = min(throttle * PWM_FULL, PWM_LARGEST)
    message.angular.z = -r


def fill_unlock(message: Any) -> None:
    """Write the setpoint of nothing, which unlocks the thrust."""
    message.linear.x = message.linear.y = message.linear.z = message.angular.z = 0.0

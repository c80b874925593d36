"""What crosses the boundary of the controller: odometry in, reference in, command out.

These are the values of the ROS messages without ROS. Everything that comes from outside, from a
node, a bag or the simulator, passes through these types, so that a flight over DDS and a flight
in one process compute the same numbers. Quaternions exist here and are turned into rotations on
the way in. Stamps are integer nanoseconds: no time is ever rounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.lie import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometrySample:
    """One ``nav_msgs/Odometry``: pose in ``frame_id`` (ENU), twist in ``child_frame_id`` (FLU).

    Shapes: ``p_WB`` (3,) [m], ``q_WB_xyzw`` (4,), ``v_WB_B`` (3,) [m/s], ``w_WB_B`` (3,) [rad/s].
    """

    stamp_ns: int
    p_WB: Array
    q_WB_xyzw: Array
    v_WB_B: Array
    w_WB_B: Array
    frame_id: str = "odom"
    child_frame_id: str = "base_link"

    @property
    def speed(self) -> float:
        """Speed over ground [m/s]."""
        return math.hypot(*self.v_WB_B.tolist())

    @property
    def up(self) -> float:
        """Cosine of the tilt: how much of the body's z axis points up."""
        x, y, _, _ = self.q_WB_xyzw.tolist()
        return float(1.0 - 2.0 * (x * x + y * y))


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandSample:
    """One ``geometry_msgs/TwistStamped`` command: throttle [0, 1] and body rates [rad/s], FLU.

    ``stamp_ns`` is the stamp of the odometry that the command answers; ``w_WB_B`` is (3,).
    """

    stamp_ns: int
    throttle: float
    w_WB_B: Array
    frame_id: str = "base_link"


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceWindow:
    """One ``trajectory_msgs/MultiDOFJointTrajectory``: samples of the reference ahead.

    ``offset_ns`` (n,) are the times of the samples after ``stamp_ns``, non-decreasing. Two samples
    at the same time mark a jump; the later one holds from that time on. All vectors are in the
    header frame (world). Shapes: ``p_WB``, ``v_WB_W``, ``a_WB_W``, ``w_WB_W`` (n, 3) in m, m/s,
    m/s^2, rad/s; ``q_WB_xyzw`` (n, 4).
    """

    stamp_ns: int
    offset_ns: NDArray[np.int64]
    p_WB: Array
    q_WB_xyzw: Array
    v_WB_W: Array
    a_WB_W: Array
    w_WB_W: Array
    frame_id: str = "odom"

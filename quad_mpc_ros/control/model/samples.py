# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Inputs and outputs of the controller: odometry, IMU, reference, command.

These types have the values of the ROS messages without ROS. Nodes, bags and the simulator all use
them, so that flights over DDS and in one process compute the same numbers. Quaternions are
converted to rotations inside the controller. Stamps are integer nanoseconds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.configuration.arguments import array, instance, number, stamp, stamps
from quad_mpc_ros.configuration.errors import ArgumentError
from quad_mpc_ros.control.lie import Array

Measured = tuple[Array, Array, Array, Array]
"""Values of an odometry for compiled code: position, attitude (4,), velocity, body rates."""

_MAX_DURATION = 1e9  # s, of a window
_MAX_VARIANCE = 25.0  # m^2/s^2 of a velocity; larger values mean unknown


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometrySample:
    """One ``nav_msgs/Odometry``: pose in ``frame_id`` (ENU), twist in ``child_frame_id`` (FLU).

    Args:
        stamp_ns: Time of the measurement [ns].
        p_WB: Position in the world (3,) [m].
        q_WB_xyzw: Attitude, body to world, a unit quaternion (4,).
        v_WB_B: Velocity in body axes (3,) [m/s].
        w_WB_B: Body rates, in body axes (3,) [rad/s].
        frame_id: The world frame.
        child_frame_id: The body frame.
        v_variance: Variance of the velocity along each axis [m^2/s^2], 0 if unknown.

    Raises:
        ArgumentError: A field has another type or shape. The controller rejects numbers that are
            not finite, as in a message.

    Example:
        >>> OdometrySample.at_rest([0.0, 0.0, 1.5], yaw=0.5).speed
        0.0
    """

    stamp_ns: int
    p_WB: Array
    q_WB_xyzw: Array
    v_WB_B: Array
    w_WB_B: Array
    frame_id: str = "odom"
    child_frame_id: str = "base_link"
    v_variance: float = 0.0

    def __post_init__(self) -> None:
        _set_converted(
            self,
            stamp_ns=stamp(self.stamp_ns, "stamp_ns"),
            p_WB=array(self.p_WB, "p_WB", 3),
            q_WB_xyzw=array(self.q_WB_xyzw, "q_WB_xyzw", 4),
            v_WB_B=array(self.v_WB_B, "v_WB_B", 3),
            w_WB_B=array(self.w_WB_B, "w_WB_B", 3),
            frame_id=instance(self.frame_id, "frame_id", str),
            child_frame_id=instance(self.child_frame_id, "child_frame_id", str),
            v_variance=number(self.v_variance, "v_variance"),
        )

    @classmethod
    def at_rest(
        cls, p_WB: ArrayLike, *, yaw: float = 0.0, stamp_ns: int = 0, frame_id: str = "odom"
    ) -> OdometrySample:
        """Return the odometry of a level vehicle that does not move.

        Args:
            p_WB: Position in the world (3,) [m].
            yaw: Heading, from east to north [rad].
            stamp_ns: Time of the measurement [ns].
            frame_id: The world frame.

        Raises:
            ArgumentError: An argument has the wrong type or shape.
        """
        return cls(
            stamp_ns=stamp_ns,
            p_WB=array(p_WB, "p_WB", 3).copy(),
            q_WB_xyzw=_level(yaw),
            v_WB_B=np.zeros(3),
            w_WB_B=np.zeros(3),
            frame_id=frame_id,
        )

    @property
    def measured(self) -> Measured:
        """Position, attitude, velocity and body rates."""
        return self.p_WB, self.q_WB_xyzw, self.v_WB_B, self.w_WB_B

    @property
    def speed(self) -> float:
        """Speed over ground [m/s]."""
        return math.hypot(*self.v_WB_B.tolist())

    @property
    def up(self) -> float:
        """Cosine of the tilt: vertical component of the body's z axis."""
        x, y, _, _ = self.q_WB_xyzw.tolist()
        return float(1.0 - 2.0 * (x * x + y * y))


def reported_variance(variances: Iterable[float]) -> float:
    """Return the largest reported velocity variance, 0 if any variance is implausible."""
    reported = [float(variance) for variance in variances]
    return max(reported) if all(0.0 < each <= _MAX_VARIANCE for each in reported) else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuSample:
    """One ``sensor_msgs/Imu``, of which only the accelerometer is used.

    Args:
        stamp_ns: Time of the measurement, or end of the interval of a mean [ns].
        f_B: Specific force in body axes (3,) [m/s^2]: acceleration minus gravity, +9.81 upwards at
            rest (REP 145).
        frame_id: The body frame.

    Raises:
        ArgumentError: A field has another type or shape.
    """

    stamp_ns: int
    f_B: Array
    frame_id: str = "base_link"

    def __post_init__(self) -> None:
        _set_converted(
            self,
            stamp_ns=stamp(self.stamp_ns, "stamp_ns"),
            f_B=array(self.f_B, "f_B", 3),
            frame_id=instance(self.frame_id, "frame_id", str),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandSample:
    """One ``geometry_msgs/TwistStamped`` command: throttle and body rates, FLU.

    Args:
        stamp_ns: Stamp of the odometry that the command answers [ns].
        throttle: Collective throttle in [0, 1].
        w_WB_B: Body rates in body axes (3,) [rad/s].
        frame_id: The body frame.
    """

    stamp_ns: int
    throttle: float
    w_WB_B: Array
    frame_id: str = "base_link"

    def checked(self) -> CommandSample:
        """Return the command of another program, with converted numbers.

        Raises:
            ArgumentError: A field has the wrong type or shape, or is not finite.
        """
        return CommandSample(
            stamp_ns=stamp(self.stamp_ns, "stamp_ns"),
            throttle=number(self.throttle, "throttle"),
            w_WB_B=array(self.w_WB_B, "w_WB_B", 3, finite=True),
            frame_id=instance(self.frame_id, "frame_id", str),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class RotorCommand(CommandSample):
    """A command to the rotors of a plant that has rotors.

    Throttle and body rates state the expected motion. Limits apply to them; if a limit changes
    them, the rate loop of the plant flies that step. Topics and bags have them alone.

    Args:
        rotor_throttles: Throttle of each rotor in [0, 1] (n,), from the nose anticlockwise, seen
            from above. Equal throttles have the thrust of the collective throttle.
    """

    rotor_throttles: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceWindow:
    """One ``trajectory_msgs/MultiDOFJointTrajectory``: n samples of the reference ahead.

    Vectors are in the header frame (world). Two samples at the same time mark a jump; the second
    sample is valid from then on.

    Args:
        stamp_ns: Start time of the offsets [ns].
        offset_ns: Times of the samples after the stamp, non-decreasing (n,) [ns].
        p_WB: Positions (n, 3) [m].
        q_WB_xyzw: Attitudes, body to world, unit quaternions (n, 4).
        v_WB_W: Velocities (n, 3) [m/s].
        a_WB_W: Accelerations (n, 3) [m/s^2].
        w_WB_W: Angular velocities (n, 3) [rad/s].
        frame_id: The world frame.

    Raises:
        ArgumentError: A field has another type or shape. The controller rejects other unusable
            values, as in a message.
    """

    stamp_ns: int
    offset_ns: NDArray[np.int64]
    p_WB: Array
    q_WB_xyzw: Array
    v_WB_W: Array
    a_WB_W: Array
    w_WB_W: Array
    frame_id: str = "odom"

    def __post_init__(self) -> None:
        offset_ns = stamps(self.offset_ns, "offset_ns")
        count = len(offset_ns)
        _set_converted(
            self,
            stamp_ns=stamp(self.stamp_ns, "stamp_ns"),
            offset_ns=offset_ns,
            p_WB=array(self.p_WB, "p_WB", count, 3),
            q_WB_xyzw=array(self.q_WB_xyzw, "q_WB_xyzw", count, 4),
            v_WB_W=array(self.v_WB_W, "v_WB_W", count, 3),
            a_WB_W=array(self.a_WB_W, "a_WB_W", count, 3),
            w_WB_W=array(self.w_WB_W, "w_WB_W", count, 3),
            frame_id=instance(self.frame_id, "frame_id", str),
        )

    @classmethod
    def hover(
        cls,
        p_WB: ArrayLike,
        *,
        yaw: float = 0.0,
        stamp_ns: int = 0,
        duration: float = 2.0,
        frame_id: str = "odom",
    ) -> ReferenceWindow:
        """Return the reference that holds a position, level.

        Args:
            p_WB: Position of the hover (3,) [m].
            yaw: Heading, from east to north [rad].
            stamp_ns: Start time [ns].
            duration: Duration [s]; at least the horizon of the MPC.
            frame_id: The world frame.

        Raises:
            ArgumentError: An argument has the wrong type or shape, or is out of range.

        Example:
            >>> ReferenceWindow.hover([0.0, 0.0, 2.0]).p_WB
            array([[0., 0., 2.],
                   [0., 0., 2.]])
        """
        rest, seconds = (
            np.zeros((2, 3)),
            number(duration, "duration", above=0.0, below=_MAX_DURATION),
        )
        return cls(
            stamp_ns=stamp_ns,
            offset_ns=np.array([0, round(seconds * 1e9)]),
            p_WB=np.tile(array(p_WB, "p_WB", 3), (2, 1)),
            q_WB_xyzw=np.tile(_level(yaw), (2, 1)),
            v_WB_W=rest,
            a_WB_W=rest,
            w_WB_W=rest,
            frame_id=frame_id,
        )

    def pose_at(self, stamp_ns: int) -> tuple[Array, Array]:
        """Return the approximate reference at a time: position (3,) and quaternion (4,).

        The position is interpolated linearly, the attitude is the previous sample's. The MPC
        samples windows exactly (``control/model/reference_window.py``).
        """
        after_ns = stamp_ns - self.stamp_ns
        offsets_ns, last = self.offset_ns, self.offset_ns.size - 1
        if last < 0:
            raise ArgumentError("offset_ns", offsets_ns, "a window with samples")
        if after_ns == int(offsets_ns[0]) and last > 0 and after_ns != int(offsets_ns[1]):
            return self.p_WB[0], self.q_WB_xyzw[0]  # as in lockstep
        before = max(int(offsets_ns.searchsorted(after_ns, side="right")) - 1, 0)
        p, q = self.p_WB[before], self.q_WB_xyzw[before]
        past_ns = after_ns - int(offsets_ns[before])
        if past_ns <= 0 or before == last:
            return p, q
        fraction = past_ns / int(offsets_ns[before + 1] - offsets_ns[before])
        return p + fraction * (self.p_WB[before + 1] - p), q


def _set_converted(sample: Any, **values: object) -> None:
    """Set the converted fields of a frozen sample."""
    fields = vars(sample)
    for name, value in values.items():
        if fields[name] is not value:
            object.__setattr__(sample, name, value)


def _level(yaw: float) -> Array:
    """Return the quaternion (4,) of a level attitude."""
    yaw = number(yaw, "yaw")
    return np.array([0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)])

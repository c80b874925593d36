"""The inputs and outputs of a controller in a recorded flight, message by message.

The bag may be of another stack: topics can be named, and pose and twist may be separate.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.messages.conversions import odometry_from_pose_and_twist
from quad_mpc_ros.messages.topics import BATTERY, COMMAND, ODOMETRY, REFERENCE, Topic
from quad_mpc_ros.recordings.logs import CommandLog, ImuLog, OdometryLog, Received, StatsLog

POSE = Topic(name="pose", type_name="geometry_msgs/msg/PoseStamped")
TWIST = Topic(name="twist", type_name="geometry_msgs/msg/TwistStamped")

VOLTAGE_FIELDS = {
    BATTERY.type_name: "voltage",
    "crazyflie_interfaces/msg/Status": "battery_voltage",
    "px4_msgs/msg/BatteryStatus": "voltage_v",
    "rosflight_msgs/msg/BatteryStatus": "voltage",
}
"""Message types with a battery's voltage [V], and its field."""

_BODY_FRAME = "base_link"
_ZERO = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)


@dataclass(frozen=True, kw_only=True)
class TopicNames:
    """Names of topics in a bag; empty stands for ours, in any namespace.

    With ``pose`` and ``twist``, both or neither, they make the odometry together. The battery's is
    the only one of a type in ``VOLTAGE_FIELDS``, whatever its name.
    """

    odometry: str = ""
    pose: str = ""
    twist: str = ""
    reference: str = ""
    command: str = ""
    battery: str = ""

    def __post_init__(self) -> None:
        if bool(self.pose) != bool(self.twist):
            raise UserError("--pose-topic and --twist-topic: given one, expected both or neither")
        if self.pose and self.odometry:
            raise UserError("--odom-topic and --pose-topic: given both, expected one of them")

    @property
    def given(self) -> dict[Topic, str]:
        """Return the topics of a known type that have a name here, with it."""
        names = {
            ODOMETRY: self.odometry,
            POSE: self.pose,
            TWIST: self.twist,
            REFERENCE: self.reference,
            COMMAND: self.command,
        }
        return {topic: name for topic, name in names.items() if name}


OUR_NAMES = TopicNames()
"""The topics of this package, in any namespace."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRun:
    """The messages of one vehicle, each kind in the order in which it was recorded.

    ``odometries`` holds at least one; those that a controller refuses are included. ``commands``
    are the flown ones, ``stats`` the figures of the ticks, ``parameters`` are by node.
    ``engagements``: whether the vehicle acts on commands from then on; it does before the first.
    ``landings``: whether it stands on the ground from then on. ``resets``: steps of the estimate.
    ``changes``: parameters of the controller set in flight. ``voltages`` of the battery [V].
    ``imu``: what an accelerometer measured.
    """

    bag: Path
    parameters: Mapping[str, Mapping[str, Any]]
    odometries: OdometryLog = field(default_factory=OdometryLog)
    windows: list[Received[ReferenceWindow]] = field(default_factory=list)
    commands: CommandLog = field(default_factory=CommandLog)
    stats: StatsLog = field(default_factory=StatsLog)
    engagements: list[Received[bool]] = field(default_factory=list)
    landings: list[Received[bool]] = field(default_factory=list)
    resets: list[Received[EstimateReset]] = field(default_factory=list)
    changes: list[Received[Mapping[str, Any]]] = field(default_factory=list)
    voltages: list[Received[float]] = field(default_factory=list)
    imu: ImuLog = field(default_factory=ImuLog)


def odometry_of_pose(message: Any) -> OdometrySample:
    """Return a ``geometry_msgs/PoseStamped`` as an odometry without motion."""
    still = SimpleNamespace(twist=SimpleNamespace(linear=_ZERO, angular=_ZERO))
    return odometry_from_pose_and_twist(message, still, child_frame_id=_BODY_FRAME)


def odometry_of_twist(message: Any) -> OdometrySample:
    """Return a ``geometry_msgs/TwistStamped`` as an odometry at the origin."""
    pose = SimpleNamespace(position=_ZERO, orientation=_ZERO)
    placed = SimpleNamespace(header=message.header, pose=pose)
    return odometry_from_pose_and_twist(placed, message, child_frame_id=_BODY_FRAME)


def joined(poses: OdometryLog, twists: OdometryLog) -> OdometryLog:
    """Return each pose with the twist stamped nearest to it, at most half a period away.

    Only the poses of the former and the twists of the latter are used.
    """
    if not poses or not twists:
        return OdometryLog()
    order = np.argsort(twists.stamp_ns, kind="stable")
    twist_ns, pose_ns = twists.stamp_ns[order], poses.stamp_ns
    gaps = np.diff(np.unique(pose_ns))
    tolerance_ns = float(np.median(gaps)) / 2.0 if len(gaps) else float("inf")
    # Up to the middle between two twists the earlier one is the nearer.
    nearest = np.searchsorted(twist_ns[:-1] + np.diff(twist_ns) // 2, pose_ns)
    near = np.abs(pose_ns - twist_ns[nearest]) <= tolerance_ns
    found = []
    for place in np.flatnonzero(near).tolist():
        pose, twist = poses[place], twists[int(order[nearest[place]])]
        moving = dataclasses.replace(
            pose.value, v_WB_B=twist.value.v_WB_B, w_WB_B=twist.value.w_WB_B
        )
        received = Received(
            value=moving,
            # Complete when both have arrived.
            log_time_ns=max(pose.log_time_ns, twist.log_time_ns),
            publish_time_ns=max(pose.publish_time_ns, twist.publish_time_ns),
        )
        found.append(received)
    return OdometryLog.of(sorted(found, key=lambda received: received.log_time_ns))

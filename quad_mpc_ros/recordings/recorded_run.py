"""What a controller was given in a recorded flight, message by message, and what it answered.

The bag may be of another stack: topics can be named, and pose and twist may come apart.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from quad_mpc_ros.configuration import BagError, UserError
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.topics import (
    COMMAND,
    ENGAGED,
    ODOMETRY,
    RECORDED_COMMAND,
    REFERENCE,
    STATS,
    Topic,
)
from quad_mpc_ros.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.recordings.parameters import read_parameters
from quad_mpc_ros.recordings.reader import BagReader, RecordedMessage
from quad_mpc_ros.recordings.recorded_stats import recorded_stats
from quad_mpc_ros.recordings.recorded_topics import listed_topics, messages_by_topic

T = TypeVar("T")

POSE = Topic(name="pose", type_name="geometry_msgs/msg/PoseStamped", reliable=False)
TWIST = Topic(name="twist", type_name="geometry_msgs/msg/TwistStamped", reliable=False)
_BODY_FRAME = "base_link"


@dataclass(frozen=True, kw_only=True)
class TopicNames:
    """Which topics of a bag are what; empty stands for ours, in whatever namespace.

    With ``pose`` and ``twist``, both or neither, they make the odometry together.
    """

    odometry: str = ""
    pose: str = ""
    twist: str = ""
    reference: str = ""
    command: str = ""

    def __post_init__(self) -> None:
        if bool(self.pose) != bool(self.twist):
            raise UserError("--pose-topic and --twist-topic: given one, expected both or neither")
        if self.pose and self.odometry:
            raise UserError("--odom-topic and --pose-topic: given both, expected one of them")


@dataclass(frozen=True, kw_only=True, eq=False)
class Received(Generic[T]):
    """A value and when its message was recorded and published [ns]."""

    value: T
    log_time_ns: int
    publish_time_ns: int


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRun:
    """The messages of one vehicle, each kind in the order in which it was recorded.

    ``odometries`` holds at least one. Nothing is left out or judged here: what a controller
    refuses is still among them. ``commands`` are those that were flown, ``stats`` the figures of
    the ticks, ``parameters`` those recorded, by node. ``engagements`` tell from when on the
    vehicle acted on commands, and from when on it did not; before the first of them it did.
    """

    bag: Path
    odometries: Sequence[Received[OdometrySample]]
    windows: Sequence[Received[ReferenceWindow]]
    commands: Sequence[Received[CommandSample]]
    stats: Sequence[TickStats]
    parameters: Mapping[str, Mapping[str, Any]]
    engagements: Sequence[Received[bool]] = ()


def read_run(
    bag: Path,
    names: TopicNames,
    *,
    topics: Collection[Topic] = (REFERENCE, COMMAND, ENGAGED, STATS),
) -> RecordedRun:
    """Read the odometry of a vehicle and ``topics`` of its controller, the others left empty.

    Raises :class:`BagError` for a bag that cannot be read, that has no odometry, that has a topic
    twice, or whose named topics are not there or of another type.
    """
    named = {
        topic: name
        for topic, name in {
            ODOMETRY: names.odometry,
            POSE: names.pose,
            TWIST: names.twist,
            REFERENCE: names.reference,
            COMMAND: names.command,
        }.items()
        if name
    }
    apart = bool(names.pose)
    wanted = (*topics, *((POSE, TWIST) if apart else (ODOMETRY,)))
    if COMMAND in wanted and not names.command:
        wanted = (*wanted, RECORDED_COMMAND)
    recorded = defaultdict(list, messages_by_topic(bag, wanted, names=named))
    # In a bag that was resolved, the vehicle flew these and not the ones beside them.
    flown = recorded[RECORDED_COMMAND] or recorded[COMMAND]
    odometries = (
        _joined(recorded[POSE], recorded[TWIST])
        if apart
        else _received(recorded[ODOMETRY], conversions.odometry_from_message)
    )
    if not odometries:
        raise BagError(
            f"{bag}: no odometry in it: expected {ODOMETRY.type_name} on a topic that ends in "
            f"/{ODOMETRY.name}, or --odom-topic, or --pose-topic with --twist-topic; it holds "
            f"{listed_topics(bag)}"
        )
    return RecordedRun(
        bag=bag,
        odometries=odometries,
        windows=_received(recorded[REFERENCE], conversions.reference_from_message),
        commands=_received(flown, conversions.command_from_message),
        stats=recorded_stats(bag, recorded[STATS]),
        parameters=read_parameters(BagReader(bag).metadata),
        engagements=_received(recorded[ENGAGED], lambda message: bool(message.data)),
    )


def _received(
    messages: Sequence[RecordedMessage], convert: Callable[[Any], T]
) -> list[Received[T]]:
    """Return the values of messages; what has no value (``ValueError``) is left out."""
    found = []
    for message in messages:
        try:
            value = convert(message.message)
        except ValueError:
            continue
        found.append(
            Received(
                value=value,
                log_time_ns=message.log_time_ns,
                publish_time_ns=message.publish_time_ns,
            )
        )
    return found


def _joined(
    poses: Sequence[RecordedMessage], twists: Sequence[RecordedMessage]
) -> list[Received[OdometrySample]]:
    """Return each pose with the twist stamped nearest to it, at most half a period away."""
    if not poses or not twists:
        return []
    twist_ns = np.array([_stamp_ns(message) for message in twists])
    order = np.argsort(twist_ns, kind="stable")
    twist_ns = twist_ns[order]
    pose_ns = np.array([_stamp_ns(message) for message in poses])
    gaps = np.diff(np.unique(pose_ns))
    tolerance_ns = float(np.median(gaps)) / 2.0 if len(gaps) else float("inf")
    after = np.clip(np.searchsorted(twist_ns, pose_ns), 1, max(len(twist_ns) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(twist_ns) - 1)
    nearest = np.where(pose_ns - twist_ns[before] <= twist_ns[after] - pose_ns, before, after)
    found = []
    for pose, stamp_ns, place in zip(poses, pose_ns.tolist(), nearest.tolist(), strict=True):
        if abs(stamp_ns - int(twist_ns[place])) > tolerance_ns:
            continue
        twist = twists[int(order[place])]
        found.append(
            Received(
                value=conversions.odometry_from_pose_and_twist(
                    pose.message, twist.message, child_frame_id=_BODY_FRAME
                ),
                # Whole when both have come.
                log_time_ns=max(pose.log_time_ns, twist.log_time_ns),
                publish_time_ns=max(pose.publish_time_ns, twist.publish_time_ns),
            )
        )
    return sorted(found, key=lambda received: received.log_time_ns)


def _stamp_ns(message: RecordedMessage) -> int:
    return conversions.nanoseconds(message.message.header.stamp)

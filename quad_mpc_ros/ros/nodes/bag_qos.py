"""Quality of service between rclpy and bags: as recorded, as subscribed, as played."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from quad_mpc_ros.recordings.qos_profile import INFINITE_NS, QosProfile
from quad_mpc_ros.ros.messages import qos_profile

_RECORDING_DEPTH = 1000  # room for a stall of several seconds
_MIN_DEPTH = 10


def recorded_profile(profile: QoSProfile) -> QosProfile:
    """Return rclpy's profile as a bag writes it down."""
    return QosProfile(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline=profile.deadline.nanoseconds,
        lifespan=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_duration=profile.liveliness_lease_duration.nanoseconds,
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def strictest_common_profile(publishers: Sequence[QoSProfile]) -> QoSProfile:
    """Return the strictest profile that every publisher of a topic can serve, as rosbag2 does."""
    reliable = all(q.reliability == ReliabilityPolicy.RELIABLE for q in publishers)
    latched = all(q.durability == DurabilityPolicy.TRANSIENT_LOCAL for q in publishers)
    profile = qos_profile(depth=_RECORDING_DEPTH, reliable=reliable, latched=latched)
    if reliable and latched:  # of lockstep, whose simulator waits for a recorder that is behind
        profile.history = HistoryPolicy.KEEP_ALL
    return profile


def playback_profile(recorded: Sequence[QosProfile]) -> QoSProfile:
    """Return the profile for publishing what publishers of these profiles had sent.

    Subscribers that matched each of them must match this one: it is reliable or latched if one of
    them was. Deadline, lifespan and liveliness are kept where all are the same.
    """
    if not recorded:
        return QoSProfile(depth=_MIN_DEPTH)
    reliable = any(profile.reliability == "reliable" for profile in recorded)
    latched = any(profile.durability == "transient_local" for profile in recorded)
    common: dict[str, Any] = {
        name: _duration(getattr(recorded[0], name))
        for name in ("deadline", "lifespan", "liveliness_lease_duration")
        if len({getattr(profile, name) for profile in recorded}) == 1
    }
    if all(profile.liveliness == "manual_by_topic" for profile in recorded):
        common["liveliness"] = LivelinessPolicy.MANUAL_BY_TOPIC
    # Over DDS the depth of a publisher is often unknown, and recorded as 0.
    depth = max(_MIN_DEPTH, *(profile.depth for profile in recorded))
    return qos_profile(depth=depth, reliable=reliable, latched=latched, **common)


def _duration(nanoseconds: int) -> Duration:
    """Return a duration; infinity is spelled zero, which is rmw's word for "not given"."""
    return Duration(nanoseconds=0 if nanoseconds == INFINITE_NS else nanoseconds)

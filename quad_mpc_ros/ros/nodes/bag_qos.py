"""Quality of service for recording and playing bags with rclpy."""

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
    """Return the profile for a bag, given rclpy's profile."""
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
    """Return the strictest profile that is compatible with all publishers, as in rosbag2."""
    reliable = all(q.reliability == ReliabilityPolicy.RELIABLE for q in publishers)
    latched = all(q.durability == DurabilityPolicy.TRANSIENT_LOCAL for q in publishers)
    profile = qos_profile(depth=_RECORDING_DEPTH, reliable=reliable, latched=latched)
    if reliable and latched:  # lockstep: the simulator waits for the recorder
        profile.history = HistoryPolicy.KEEP_ALL
    return profile


def playback_profile(recorded: Sequence[QosProfile]) -> QoSProfile:
    """Return the profile to play messages that publishers with these profiles sent.

    It must match subscribers of any of these publishers: it is reliable or latched if one of them
    was. Deadline, lifespan and liveliness are kept if all are equal.
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
    # DDS often does not report the depth of a publisher; then it is recorded as 0.
    depth = max(_MIN_DEPTH, *(profile.depth for profile in recorded))
    return qos_profile(depth=depth, reliable=reliable, latched=latched, **common)


def _duration(nanoseconds: int) -> Duration:
    """Return a duration; infinity becomes zero, which is rmw's value for "unspecified"."""
    return Duration(nanoseconds=0 if nanoseconds == INFINITE_NS else nanoseconds)

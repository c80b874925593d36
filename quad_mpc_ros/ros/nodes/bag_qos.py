# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service for recording and playing bags with rclpy."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
)

from quad_mpc_ros.recordings.qos import qos_time
from quad_mpc_ros.ros.messages import qos_profile

_RECORDING_DEPTH = 1000  # room for a stall of several seconds
_MIN_DEPTH = 10


def recorded_profile(profile: QoSProfile) -> Qos:
    """Return the profile for a bag, given rclpy's profile."""
    return Qos(
        history=QosHistory[profile.history.name],
        depth=profile.depth,
        reliability=QosReliability[profile.reliability.name],
        durability=QosDurability[profile.durability.name],
        deadline=qos_time(profile.deadline.nanoseconds),
        lifespan=qos_time(profile.lifespan.nanoseconds),
        liveliness=QosLiveliness[profile.liveliness.name],
        liveliness_lease_duration=qos_time(profile.liveliness_lease_duration.nanoseconds),
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


def playback_profile(recorded: Sequence[Qos]) -> QoSProfile:
    """Return the profile to play messages that publishers with these profiles sent.

    The profile must match subscribers of any of these publishers: it is reliable or latched if any
    of them was. Deadline, lifespan and liveliness are the defaults.
    """
    if not recorded:
        return QoSProfile(depth=_MIN_DEPTH)
    reliable = any(profile.reliability == QosReliability.RELIABLE for profile in recorded)
    latched = any(profile.durability == QosDurability.TRANSIENT_LOCAL for profile in recorded)
    # DDS often does not report the depth of a publisher; then it is recorded as 0.
    depth = max(_MIN_DEPTH, *(profile.depth for profile in recorded))
    return qos_profile(depth=depth, reliable=reliable, latched=latched)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service in bags: the profiles of rosbags in the YAML of rosbag2."""

from __future__ import annotations

from collections.abc import Sequence

import yaml
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

INFINITE_NS = 2**63 - 1
"""``RMW_DURATION_INFINITE`` [ns]."""

_NS_PER_S = 1_000_000_000


def offered_qos(*, depth: int = 10, reliable: bool = True, latched: bool = False) -> Qos:
    """Return the profile of a publisher with default deadline, lifespan and liveliness."""
    infinite = qos_time(INFINITE_NS)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=depth,
        reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=infinite,
        lifespan=infinite,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=infinite,
        avoid_ros_namespace_conventions=False,
    )


def qos_time(duration_ns: int) -> QosTime:
    """Return a duration [ns] as rosbag2 stores it."""
    return QosTime(*divmod(duration_ns, _NS_PER_S))


def qos_entries(profiles: Sequence[Qos]) -> list[dict[str, object]]:
    """Return profiles as the entries of ``metadata.yaml``, version 9."""
    return [dict(entry) for entry in dump_qos_v9(list(profiles))]


def qos_text(profiles: Sequence[Qos]) -> str:
    """Return the YAML of the channel metadata ``offered_qos_profiles``."""
    text: str = yaml.safe_dump(qos_entries(profiles), sort_keys=False)
    return text


def parse_qos_text(text: str) -> list[Qos]:
    """Return the profiles in the channel metadata ``offered_qos_profiles``.

    The words of version 9 and the numbers of older bags are supported. Empty for unreadable text
    of other writers, so that messages can still be used.
    """
    try:
        return parse_qos(text)
    except (ReaderError, AttributeError, KeyError, TypeError):
        return []

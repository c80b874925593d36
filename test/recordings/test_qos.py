# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service in bags of this version and of older ones."""

from __future__ import annotations

import pytest
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
)
from rosbags.rosbag2.metadata import dump_qos_v8

from quad_mpc_ros.recordings.qos import (
    INFINITE_NS,
    offered_qos,
    parse_qos_text,
    qos_text,
    qos_time,
)

DISCOVERED = offered_qos(depth=0)._replace(history=QosHistory.UNKNOWN)
UNUSUAL = Qos(
    history=QosHistory.KEEP_ALL,
    depth=7,
    reliability=QosReliability.BEST_EFFORT,
    durability=QosDurability.TRANSIENT_LOCAL,
    deadline=qos_time(1_500_000_000),
    lifespan=qos_time(INFINITE_NS),
    liveliness=QosLiveliness.MANUAL_BY_TOPIC,
    liveliness_lease_duration=qos_time(3_000_000_004),
    avoid_ros_namespace_conventions=True,
)


def test_reads_words_and_the_numbers_of_older_bags() -> None:
    for profiles in ([], [UNUSUAL], [UNUSUAL, DISCOVERED, DISCOVERED]):
        text = qos_text(profiles)
        assert parse_qos_text(text) == profiles
        assert "&" not in text  # two publishers are two entries, no alias
    assert parse_qos_text(str(dump_qos_v8([UNUSUAL]))) == [UNUSUAL]


@pytest.mark.parametrize("text", ["", "- 1", "a: [", "- history: keep_last", "7"])
def test_text_of_another_writer_has_no_profiles(text: str) -> None:
    assert parse_qos_text(text) == []

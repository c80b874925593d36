"""QoS text against rosbags' parser and against text that rosbag2 Jazzy wrote."""

from __future__ import annotations

import pytest
import yaml
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2.metadata import dump_qos_v8, parse_qos

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.recordings.bag_metadata import qos_profiles_text
from quad_mpc_ros.recordings.qos_profile import QosProfile, parse_qos_profiles

# As `ros2 bag record` of Jazzy on Fast DDS writes a reliable publisher: history and depth are
# not part of discovery.
RECORDED_BY_ROSBAG2 = """\
- history: unknown
  depth: 0
  reliability: reliable
  durability: volatile
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""


@pytest.mark.parametrize("count", [0, 1, 2])
def test_entries_are_those_of_rosbag2(count: int) -> None:
    (recorded,) = yaml.safe_load(RECORDED_BY_ROSBAG2)
    text = qos_profiles_text(count * [QosProfile(history="unknown", depth=0)])
    assert yaml.safe_load(text) == count * [recorded]
    assert "&" not in text  # two publishers are two entries, no alias


def test_rosbags_reads_every_field_back() -> None:
    profile = QosProfile(
        history="keep_all",
        depth=7,
        reliability="best_effort",
        durability="transient_local",
        deadline=1_500_000_000,
        lifespan=2,
        liveliness="manual_by_topic",
        liveliness_lease_duration=3_000_000_004,
        avoid_ros_namespace_conventions=True,
    )
    (read,) = parse_qos(qos_profiles_text([profile]))
    assert read.history == QosHistory.KEEP_ALL
    assert read.depth == 7
    assert read.reliability == QosReliability.BEST_EFFORT
    assert read.durability == QosDurability.TRANSIENT_LOCAL
    assert (read.deadline.sec, read.deadline.nsec) == (1, 500_000_000)
    assert (read.lifespan.sec, read.lifespan.nsec) == (0, 2)
    assert read.liveliness == QosLiveliness.MANUAL_BY_TOPIC
    lease = read.liveliness_lease_duration
    assert (lease.sec, lease.nsec) == (3, 4)
    assert read.avoid_ros_namespace_conventions is True


@pytest.mark.parametrize(
    "fields", [{"reliability": "RELIABLE"}, {"history": 1}, {"depth": -1}, {"deadline": 2**63}]
)
def test_refuses_what_rosbag2_cannot_read(fields: dict[str, object]) -> None:
    (name,) = fields
    with pytest.raises(BagError, match=f"QoS {name}: given .*, expected"):
        QosProfile(**fields)  # type: ignore[arg-type]


PROFILES = (
    QosProfile(history="unknown", depth=0),
    QosProfile(
        history="keep_all",
        depth=7,
        reliability="best_effort",
        durability="transient_local",
        deadline=1_500_000_000,
        liveliness="manual_by_topic",
        liveliness_lease_duration=3_000_000_004,
    ),
)


@pytest.mark.parametrize("profiles", [(), PROFILES[:1], PROFILES])
def test_written_profiles_are_read_back(profiles: tuple[QosProfile, ...]) -> None:
    assert parse_qos_profiles(qos_profiles_text(profiles)) == profiles


def test_reads_the_numbers_of_older_bags() -> None:
    forever = QosTime(9223372036, 854775807)
    text = dump_qos_v8(
        [
            Qos(
                QosHistory.KEEP_ALL,
                7,
                QosReliability.BEST_EFFORT,
                QosDurability.TRANSIENT_LOCAL,
                QosTime(1, 500_000_000),
                forever,
                QosLiveliness.MANUAL_BY_TOPIC,
                QosTime(3, 4),
                False,
            )
        ]
    )
    assert parse_qos_profiles(str(text)) == PROFILES[1:]


@pytest.mark.parametrize("text", ["- 1", "a: [", "- history: keep_last", "7", "- history: 99"])
def test_refuses_text_that_is_no_list_of_profiles(text: str) -> None:
    with pytest.raises(BagError, match="offered_qos_profiles") as caught:
        parse_qos_profiles(text)
    assert "\n" not in str(caught.value)

"""The metadata of rosbag2: ``metadata.yaml``, and the QoS of a channel."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from quad_mpc_ros.recordings.qos_profile import QosProfile

METADATA_VERSION = 9
METADATA_FILE = "metadata.yaml"
METADATA_ROOT = "rosbag2_bagfile_information"

# The schemas and type hashes that this package ships are those of this distribution.
_ROS_DISTRO = "jazzy"

# A bag without messages starts at the end of time: SequentialWriter::init_metadata.
_NEVER_NS = 2**63 - 1


@dataclass(frozen=True, kw_only=True)
class TopicSummary:
    """One topic of a bag, as ``metadata.yaml`` has it."""

    name: str
    type_name: str
    type_hash: str
    qos_profiles: tuple[QosProfile, ...]
    message_count: int


@dataclass(frozen=True, kw_only=True)
class TimeSpan:
    """The first and the last log time of a bag [ns since the epoch]."""

    start_ns: int
    end_ns: int

    @property
    def duration_ns(self) -> int:
        """Return the length of the span [ns]."""
        return self.end_ns - self.start_ns


@dataclass(frozen=True, kw_only=True)
class FileSummary:
    """One file of a bag; ``span`` is None when it holds no message."""

    name: str
    span: TimeSpan | None
    message_count: int


def bag_of(path: Path) -> Path:
    """Return the bag at a path, or in it where that is the folder of a run."""
    inside = path / "bag"
    return inside if inside.is_dir() and not (path / METADATA_FILE).exists() else path


def extended(span: TimeSpan | None, time_ns: int) -> TimeSpan:
    """Return ``span``, or none yet, widened to hold ``time_ns`` [ns since the epoch]."""
    if span is None:
        return TimeSpan(start_ns=time_ns, end_ns=time_ns)
    return TimeSpan(start_ns=min(span.start_ns, time_ns), end_ns=max(span.end_ns, time_ns))


def united(spans: Iterable[TimeSpan | None]) -> TimeSpan | None:
    """Return the span that holds all ``spans``, or None when there is none."""
    known = [span for span in spans if span is not None]
    if not known:
        return None
    return TimeSpan(
        start_ns=min(span.start_ns for span in known), end_ns=max(span.end_ns for span in known)
    )


def bag_information(
    *,
    files: Sequence[FileSummary],
    topics: Sequence[TopicSummary],
    compression_format: str = "",
    compression_mode: str = "",
) -> dict[str, object]:
    """Return the content of ``rosbag2_bagfile_information`` for a bag of these files.

    The compression is rosbag2's own, by message or by file; that of MCAP's chunks is none.
    The keys are those of ``convert<BagMetadata>::encode`` in rosbag2_storage/yaml.hpp (Jazzy).
    """
    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        **_times(united(file.span for file in files)),
        "message_count": sum(file.message_count for file in files),
        "topics_with_message_count": [_topic_information(topic) for topic in topics],
        "compression_format": compression_format,
        "compression_mode": compression_mode,
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                **_times(file.span),
                "message_count": file.message_count,
            }
            for file in files
        ],
        "custom_data": None,
        "ros_distro": _ROS_DISTRO,
    }


def qos_profiles_text(profiles: Sequence[QosProfile]) -> str:
    """Return the YAML of the channel metadata ``offered_qos_profiles``.

    As rosbag2 of Jazzy: version 9, words where older bags have numbers.
    """
    return dump_yaml([profile.as_mapping() for profile in profiles])


def dump_yaml(value: object) -> str:
    """Return ``value`` as YAML; keys keep their order."""
    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True)
    return text


def _times(span: TimeSpan | None) -> dict[str, object]:
    return {
        "duration": {"nanoseconds": span.duration_ns if span else 0},
        "starting_time": {"nanoseconds_since_epoch": span.start_ns if span else _NEVER_NS},
    }


def _topic_information(topic: TopicSummary) -> dict[str, object]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": [profile.as_mapping() for profile in topic.qos_profiles],
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.message_count,
    }

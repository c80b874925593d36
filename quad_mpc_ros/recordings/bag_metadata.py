# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The metadata of rosbag2, derived from the files of a bag: ``metadata.yaml``."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import yaml

from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.recordings.mcap_file import (
    METADATA_FILE,
    McapFile,
    TimeSpan,
    topics_in,
    united_span,
)
from quad_mpc_ros.recordings.qos import parse_qos_text, qos_entries

METADATA_ROOT = "rosbag2_bagfile_information"

# Jazzy writes version 9. The schemas and type hashes of this package are from Jazzy, too.
_METADATA_VERSION = 9
_ROS_DISTRO = "jazzy"

# A bag without messages starts at the end of time: SequentialWriter::init_metadata.
_NEVER_NS = 2**63 - 1


def bag_of(path: Path) -> Path:
    """Return the bag at a path, or in the folder of a run."""
    inside = path / "bag"
    return inside if inside.is_dir() and not (path / METADATA_FILE).exists() else path


def write_metadata(directory: Path, files: Sequence[McapFile]) -> None:
    """Write the ``metadata.yaml`` of a bag of these files atomically."""
    information = textwrap.indent(bag_information(files), "  ")
    write_atomically(directory / METADATA_FILE, f"{METADATA_ROOT}:\n{information}")


def sync_directory(directory: Path) -> None:
    """Wait until the names in ``directory`` are on the device, if the system supports this."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def bag_information(files: Sequence[McapFile] = ()) -> str:
    """Return ``rosbag2_bagfile_information`` of a bag of these files as YAML.

    rosbag2 also stores it at the beginning of a file, without messages, so that an interrupted
    recording contains the version. ``convert<BagMetadata>::encode`` in
    rosbag2_storage/yaml.hpp (Jazzy) defines the keys.
    """
    names = [file.path.name for file in files]
    information = {
        "version": _METADATA_VERSION,
        "storage_identifier": "mcap",
        **_times(united_span(files)),
        "message_count": sum(file.statistics.message_count for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos_entries(parse_qos_text(topic.qos_profiles)),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for name, topic in topics_in(files).items()
        ],
        "compression_format": "",  # of rosbag2; the files name the compression of MCAP
        "compression_mode": "",
        "relative_file_paths": names,
        "files": [
            {
                "path": name,
                **_times(file.span),
                "message_count": file.statistics.message_count,
            }
            for name, file in zip(names, files, strict=True)
        ],
        "custom_data": None,
        "ros_distro": _ROS_DISTRO,
    }
    text: str = yaml.safe_dump(information, sort_keys=False, allow_unicode=True)
    return text


def _times(span: TimeSpan | None) -> dict[str, object]:
    return {
        "duration": {"nanoseconds": span.duration_ns if span else 0},
        "starting_time": {"nanoseconds_since_epoch": span.start_ns if span else _NEVER_NS},
    }

"""Writing one MCAP file of a bag."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mcap.writer import CompressionType, Writer

from quad_mpc_ros.messages.schemas import MessageSchema
from quad_mpc_ros.recordings.bag_metadata import FileSummary, TimeSpan, extended, qos_profiles_text
from quad_mpc_ros.recordings.mcap_records import LIBRARY
from quad_mpc_ros.recordings.qos_profile import QosProfile

Compression = Literal["none", "zstd", "lz4"]


@dataclass(frozen=True, kw_only=True)
class RecordedTopic:
    """A topic as a bag knows it."""

    name: str
    schema: MessageSchema
    qos_profiles: Sequence[QosProfile]


class McapOutput:
    """One MCAP file being written, in the profile of ROS 2.

    Messages gather in a chunk until :meth:`flush` or until it is full. With ``durable`` a flush
    waits until the storage device has the data. Raises ``OSError`` for everything the disk
    refuses; ``FileExistsError`` for a file that exists.
    """

    def __init__(self, path: Path, *, compression: Compression, durable: bool) -> None:
        self._path = path
        self._durable = durable
        self._span: TimeSpan | None = None
        self._message_count = 0
        self._schema_ids: dict[str, int] = {}
        self._channel_ids: dict[str, int] = {}
        self._stream = path.open("xb")
        self._mcap = Writer(
            self._stream, compression=CompressionType[compression.upper()], enable_data_crcs=True
        )
        self._mcap.start(profile="ros2", library=LIBRARY)

    @property
    def summary(self) -> FileSummary:
        """Return what ``metadata.yaml`` says of this file."""
        return FileSummary(
            name=self._path.name, span=self._span, message_count=self._message_count
        )

    @property
    def size(self) -> int:
        """Return the bytes written, without the chunk that is still gathering."""
        return self._stream.tell()

    def add_topic(self, topic: RecordedTopic) -> None:
        """Announce a topic."""
        schema = topic.schema
        if schema.type_name not in self._schema_ids:
            self._schema_ids[schema.type_name] = self._mcap.register_schema(
                name=schema.type_name, encoding=schema.encoding, data=schema.text.encode()
            )
        self._channel_ids[topic.name] = self._mcap.register_channel(
            topic=topic.name,
            message_encoding="cdr",
            schema_id=self._schema_ids[schema.type_name],
            metadata={
                "offered_qos_profiles": qos_profiles_text(topic.qos_profiles),
                "topic_type_hash": schema.type_hash,
            },
        )

    def write(self, topic: str, data: bytes, *, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one serialized message of an announced topic."""
        self._mcap.add_message(
            channel_id=self._channel_ids[topic],
            log_time=log_time_ns,
            data=data,
            publish_time=publish_time_ns,
        )
        self._message_count += 1
        self._span = extended(self._span, log_time_ns)

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append an MCAP Metadata record."""
        self._mcap.add_metadata(name, dict(values))

    def flush(self) -> None:
        """End the chunk and hand everything to the operating system, or to the device."""
        self._mcap.flush()  # type: ignore[no-untyped-call]
        if self._durable:
            os.fdatasync(self._stream.fileno())

    def finish(self) -> None:
        """Write the index and close the file."""
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        if self._durable:
            os.fsync(self._stream.fileno())
        self._stream.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        # The buffer that could not be written is still full: closing fails once more.
        with suppress(OSError):
            self._stream.close()


def sync_directory(directory: Path) -> None:
    """Wait until the device knows the names in ``directory``, where the system can do that."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

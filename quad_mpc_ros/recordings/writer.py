"""Writing a bag: a rosbag2 directory of one MCAP file or several."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple, Self, get_args

from mcap.writer import CompressionType, Writer

from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.messages.schemas import MSG_ENCODING, MessageSchema, schema_for
from quad_mpc_ros.recordings import bag_metadata
from quad_mpc_ros.recordings.mcap_records import LIBRARY
from quad_mpc_ros.recordings.qos_profile import QosProfile

Compression = Literal["none", "zstd", "lz4"]

FLUSH_PERIOD_S = 0.5
"""How long :meth:`BagWriter.flush_if_due` lets messages gather [s]."""

_MAX_TIME_NS = 2**63 - 1


@dataclass(frozen=True, kw_only=True)
class Split:
    """When a bag goes on in a new file; 0 is never.

    A file ends before the first message that comes when it has ``max_size`` bytes, or that is
    ``max_duration_ns`` later than its first one. The chunk that still gathers is not counted.
    """

    max_size: int = 0
    max_duration_ns: int = 0


ONE_FILE = Split()
"""A bag that is never split."""


class _Topic(NamedTuple):
    schema: MessageSchema
    qos_profiles: tuple[QosProfile, ...]


class BagWriter:
    """A bag being written: ``<directory>/<directory name>_<n>.mcap`` and ``metadata.yaml``.

    Messages gather in a chunk; :meth:`flush_if_due` and :meth:`close` end it and hand it to the
    operating system. What was handed over survives the death of this process, even by SIGKILL,
    and can be read without the end of the file. It survives a power failure too when ``durable``
    is set: then every flush waits for the storage device. ``metadata.yaml`` appears last, in one
    piece: a bag that has it is complete.

    Not thread-safe. Every failure is a :class:`BagError`; after a disk error the writer is
    closed and the bag ends at the last whole chunk.
    """

    # The file being written.
    _stream: BinaryIO
    _mcap: Writer
    _span: bag_metadata.TimeSpan | None
    _message_count: int

    def __init__(
        self,
        directory: Path,
        *,
        compression: Compression = "zstd",
        split: Split = ONE_FILE,
        durable: bool = False,
    ) -> None:
        """Create ``directory`` (parents made) and start the recording in it.

        Raises :class:`BagError`, with nothing touched, when the path exists already, when it
        cannot be created, or when the compression is unknown.
        """
        if compression not in get_args(Compression):
            expected = ", ".join(get_args(Compression))
            raise BagError(f"compression: given {compression!r}, expected one of {expected}")
        self.directory = directory
        self._compression: Compression = compression
        self._split = split
        self._durable = durable
        self._closed_because = ""
        self._topics: dict[str, _Topic] = {}
        self._counts: dict[str, int] = {}
        self._finished: list[bag_metadata.FileSummary] = []
        self._unflushed = False
        self._flushed_at_s = float("-inf")
        try:
            directory.mkdir(parents=True)
            self._open_file()
        except FileExistsError as error:
            raise BagExistsError(directory) from error
        except OSError as error:
            raise BagError(
                f"{directory} cannot be created: {os_reason(error)}; choose a directory that you "
                "may write to"
            ) from error
        with self._disk():
            # As rosbag2 does: a recording that is cut short has its version too.
            self._write_bag_information()
            self._flush_file()
            if durable:
                sync_directory(directory)
                sync_directory(directory.absolute().parent)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add_topic(
        self, topic: str, type_name: str, *, qos_profiles: Sequence[QosProfile] = ()
    ) -> None:
        """Announce ``topic`` (the full name) with the QoS of each of its publishers.

        Raises :class:`BagError` for a topic announced before and for a type without schema.
        """
        if topic in self._topics:
            raise BagError(f"{self._file}: topic {topic} was added before")
        self._topics[topic] = _Topic(schema_for(type_name), tuple(qos_profiles))
        self._counts[topic] = 0
        with self._disk():
            self._register(topic)

    def write(self, topic: str, data: bytes, *, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one serialized message; times are nanoseconds since the epoch of the clock.

        Raises :class:`BagError` for a topic that was not added, a time that rosbag2 could not
        hold (negative, or 2^63 and more), and a disk error.
        """
        if topic not in self._topics:
            raise BagError(f"{self._file}: topic {topic} was not added before the first message")
        if not (0 <= log_time_ns <= _MAX_TIME_NS and 0 <= publish_time_ns <= _MAX_TIME_NS):
            raise BagError(
                f"{self._file}: {topic}: time {log_time_ns} or {publish_time_ns} ns is outside "
                f"0 to {_MAX_TIME_NS}"
            )
        with self._disk():
            if self._is_full(log_time_ns):
                self._go_on_in_a_new_file()
            self._mcap.add_message(
                channel_id=self._channel_ids[topic],
                log_time=log_time_ns,
                data=data,
                publish_time=publish_time_ns,
            )
        self._message_count += 1
        self._span = bag_metadata.extended(self._span, log_time_ns)
        self._counts[topic] += 1
        self._unflushed = True

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append an MCAP Metadata record; the last one of a name is the one that counts."""
        with self._disk():
            self._mcap.add_metadata(name, dict(values))
        self._unflushed = True

    def flush_if_due(self, monotonic_now_s: float) -> None:
        """Hand what has gathered to the operating system when the last time is long enough ago.

        Call it several times a second whether messages come or not, with the time of a monotonic
        clock [s]: then nothing older than one second is lost with the process.
        Flushing ends the chunk, and small chunks compress badly: hence not at every call.
        """
        if self._unflushed and monotonic_now_s - self._flushed_at_s >= FLUSH_PERIOD_S:
            self.flush()
            self._flushed_at_s = monotonic_now_s

    def flush(self) -> None:
        """Hand what has gathered to the operating system."""
        if self._unflushed:
            with self._disk():
                self._flush_file()
            self._unflushed = False

    def close(self) -> None:
        """Complete the bag: index, ``metadata.yaml``. A closed bag stays as it is."""
        if self._closed_because:
            return
        with self._disk():
            self._finish_file()
            text = bag_metadata.dump_yaml(
                {bag_metadata.METADATA_ROOT: self._bag_information(self._finished)}
            )
            write_atomically(self.directory / bag_metadata.METADATA_FILE, text)
            if self._durable:
                sync_directory(self.directory)
        self._closed_because = "closed"

    @property
    def _file(self) -> Path:
        return self.directory / f"{self.directory.name}_{len(self._finished)}.mcap"

    @property
    def _summary(self) -> bag_metadata.FileSummary:
        return bag_metadata.FileSummary(
            name=self._file.name, span=self._span, message_count=self._message_count
        )

    def _open_file(self) -> None:
        self._span = None
        self._message_count = 0
        self._schema_ids: dict[str, int] = {}
        self._channel_ids: dict[str, int] = {}
        self._stream = self._file.open("xb")
        compression = CompressionType[self._compression.upper()]
        self._mcap = Writer(self._stream, compression=compression, enable_data_crcs=True)
        self._mcap.start(profile="ros2", library=LIBRARY)

    def _register(self, topic: str) -> None:
        """Announce a topic in the file."""
        schema, qos_profiles = self._topics[topic]
        if schema.type_name not in self._schema_ids:
            self._schema_ids[schema.type_name] = self._mcap.register_schema(
                name=schema.type_name, encoding=MSG_ENCODING, data=schema.text.encode()
            )
        self._channel_ids[topic] = self._mcap.register_channel(
            topic=topic,
            message_encoding="cdr",
            schema_id=self._schema_ids[schema.type_name],
            metadata={
                "offered_qos_profiles": bag_metadata.qos_profiles_text(qos_profiles),
                "topic_type_hash": schema.type_hash,
            },
        )

    def _is_full(self, log_time_ns: int) -> bool:
        if self._span is None:
            return False
        if 0 < self._split.max_size <= self._stream.tell():
            return True
        return 0 < self._split.max_duration_ns <= log_time_ns - self._span.start_ns

    def _go_on_in_a_new_file(self) -> None:
        self._finish_file()
        self._open_file()
        self._write_bag_information()
        for topic in self._topics:
            self._register(topic)
        if self._durable:
            sync_directory(self.directory)

    def _flush_file(self) -> None:
        """End the chunk and hand everything to the operating system, or to the device."""
        self._mcap.flush()  # type: ignore[no-untyped-call]
        if self._durable:
            os.fdatasync(self._stream.fileno())

    def _finish_file(self) -> None:
        """Write the index and close the file."""
        self._write_bag_information()
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        if self._durable:
            os.fsync(self._stream.fileno())
        self._stream.close()
        self._finished.append(self._summary)

    def _write_bag_information(self) -> None:
        text = bag_metadata.dump_yaml(self._bag_information([*self._finished, self._summary]))
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})

    def _bag_information(self, files: Sequence[bag_metadata.FileSummary]) -> dict[str, object]:
        topics = [
            bag_metadata.TopicSummary(
                name=name,
                type_name=topic.schema.type_name,
                type_hash=topic.schema.type_hash,
                qos_profiles=topic.qos_profiles,
                message_count=self._counts[name],
            )
            for name, topic in self._topics.items()
        ]
        return bag_metadata.bag_information(files=files, topics=topics)

    @contextmanager
    def _disk(self) -> Iterator[None]:
        if self._closed_because:
            raise BagError(f"{self._file}: cannot write: the bag is {self._closed_because}")
        try:
            yield
        except OSError as error:
            self._closed_because = f"closed after a disk error ({os_reason(error)})"
            with suppress(OSError):  # the buffer that could not be written is still full
                self._stream.close()
            raise BagError(
                f"{self._file}: cannot write: {os_reason(error)}; the bag ends here, "
                "free space or record elsewhere"
            ) from error


class BagExistsError(BagError):
    """The directory of a new bag exists already."""

    def __init__(self, directory: Path) -> None:
        super().__init__(f"{directory} exists already; choose another name or move it")


def sync_directory(directory: Path) -> None:
    """Wait until the device knows the names in ``directory``, where the system can do that."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

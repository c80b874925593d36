"""Writing a bag: a rosbag2 directory with one MCAP file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Literal, Self, get_args

from mcap.writer import CompressionType, Writer

from quad_mpc_ros import __version__
from quad_mpc_ros.bags.bag_metadata import (
    METADATA_FILE,
    METADATA_ROOT,
    TimeSpan,
    TopicSummary,
    bag_information,
    extended,
)
from quad_mpc_ros.bags.errors import BagError, os_reason
from quad_mpc_ros.bags.qos_profile import QosProfile, qos_profiles_text
from quad_mpc_ros.bags.rosbag2_yaml import dump_yaml
from quad_mpc_ros.bags.schemas import schema_for

Compression = Literal["none", "zstd", "lz4"]

FLUSH_PERIOD_S = 0.5
"""How long :meth:`BagWriter.flush_if_due` lets messages gather [s]."""

_MAX_TIME_NS = 2**63 - 1


class BagWriter:
    """A bag being written: ``<directory>/<directory name>_0.mcap`` and ``metadata.yaml``.

    Messages gather in a chunk; :meth:`flush_if_due` and :meth:`close` end it and hand it to the
    operating system. What was handed over survives the death of this process, even by SIGKILL,
    and can be read without the end of the file; a power failure may still take what the kernel
    has not written. ``metadata.yaml`` appears last, in one piece: a bag that has it is complete.

    Not thread-safe. Every failure is a :class:`BagError`; after a disk error the writer is
    closed and the bag ends at the last whole chunk.
    """

    def __init__(self, directory: Path, *, compression: Compression = "zstd") -> None:
        """Create ``directory`` (parents made) and start the recording in it.

        Raises :class:`BagError`, with nothing touched, when the path exists already, when it
        cannot be created, or when the compression is unknown.
        """
        if compression not in _COMPRESSIONS:
            expected = ", ".join(get_args(Compression))
            raise BagError(f"compression: given {compression!r}, expected one of {expected}")
        self._directory = directory
        self._file = directory / f"{directory.name}_0.mcap"
        self._closed_because = ""
        self._topics: dict[str, _Topic] = {}
        self._schema_ids: dict[str, int] = {}
        self._span: TimeSpan | None = None
        self._unflushed = False
        self._flushed_at_s = float("-inf")
        self._stream = _create(directory, self._file)
        self._mcap = Writer(self._stream, compression=_COMPRESSIONS[compression])
        with self._disk():
            self._mcap.start(profile="ros2", library=f"quad_mpc_ros {__version__}")
            # As rosbag2 does: a recording that is cut short tells its version too.
            self._write_bag_information()
            self._mcap.flush()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def directory(self) -> Path:
        """Return the bag's directory, as given."""
        return self._directory

    def add_topic(
        self, topic: str, type_name: str, *, qos_profiles: Sequence[QosProfile] = ()
    ) -> None:
        """Announce ``topic`` (the full name) with the QoS of each of its publishers.

        Raises :class:`BagError` for a topic announced before and for a type without schema.
        """
        if topic in self._topics:
            raise BagError(f"{self._file}: topic {topic} was added before")
        schema = schema_for(type_name)
        with self._disk():
            if type_name not in self._schema_ids:
                self._schema_ids[type_name] = self._mcap.register_schema(
                    name=type_name, encoding="ros2msg", data=schema.text.encode()
                )
            channel_id = self._mcap.register_channel(
                topic=topic,
                message_encoding="cdr",
                schema_id=self._schema_ids[type_name],
                metadata={
                    "offered_qos_profiles": qos_profiles_text(qos_profiles),
                    "topic_type_hash": schema.type_hash,
                },
            )
        self._topics[topic] = _Topic(channel_id, type_name, schema.type_hash, tuple(qos_profiles))

    def write(self, topic: str, data: bytes, *, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one serialized message; times are nanoseconds since the epoch of the clock.

        Raises :class:`BagError` for a topic that was not added, a time that rosbag2 could not
        hold (negative, or 2^63 and more), and a disk error.
        """
        entry = self._topics.get(topic)
        if entry is None:
            raise BagError(f"{self._file}: topic {topic} was not added before the first message")
        if not (0 <= log_time_ns <= _MAX_TIME_NS and 0 <= publish_time_ns <= _MAX_TIME_NS):
            raise BagError(
                f"{self._file}: {topic}: time {log_time_ns} or {publish_time_ns} ns is outside "
                f"0 to {_MAX_TIME_NS}"
            )
        with self._disk():
            self._mcap.add_message(
                channel_id=entry.channel_id,
                log_time=log_time_ns,
                data=data,
                publish_time=publish_time_ns,
            )
        entry.message_count += 1
        self._span = extended(self._span, log_time_ns)
        self._unflushed = True

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append an MCAP Metadata record; the last one of a name is the one that counts."""
        with self._disk():
            self._mcap.add_metadata(name, dict(values))
        self._unflushed = True

    def flush_if_due(self, monotonic_now_s: float) -> None:
        """Hand what has gathered to the operating system when the last time is long enough ago.

        Call it at least twice a second whether messages come or not, with the time of a
        monotonic clock [s]: then nothing older than one second is ever lost with the process.
        Flushing ends the chunk, and small chunks compress badly: hence not at every call.
        """
        if self._unflushed and monotonic_now_s - self._flushed_at_s >= FLUSH_PERIOD_S:
            with self._disk():
                self._mcap.flush()  # type: ignore[no-untyped-call]
            self._unflushed = False
            self._flushed_at_s = monotonic_now_s

    def close(self) -> None:
        """Complete the bag: index, ``metadata.yaml``. A closed bag stays as it is."""
        if self._closed_because:
            return
        with self._disk():
            self._write_bag_information()
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._stream.close()
            text = dump_yaml({METADATA_ROOT: self._bag_information()})
            _write_in_one_piece(self._directory / METADATA_FILE, text)
        self._closed_because = "closed"

    def _write_bag_information(self) -> None:
        text = dump_yaml(self._bag_information())
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})

    def _bag_information(self) -> dict[str, object]:
        topics = [topic.summary(name) for name, topic in self._topics.items()]
        return bag_information(file_name=self._file.name, topics=topics, span=self._span)

    @contextmanager
    def _disk(self) -> Iterator[None]:
        if self._closed_because:
            raise BagError(f"{self._file}: cannot write: the bag is {self._closed_because}")
        try:
            yield
        except OSError as error:
            self._closed_because = f"closed after a disk error ({os_reason(error)})"
            # The buffer that could not be written is still full: closing fails once more.
            with suppress(OSError):
                self._stream.close()
            raise BagError(
                f"{self._file}: cannot write: {os_reason(error)}; the bag ends here, "
                "free space or record elsewhere"
            ) from error


class _Topic:
    def __init__(
        self,
        channel_id: int,
        type_name: str,
        type_hash: str,
        qos_profiles: tuple[QosProfile, ...],
    ) -> None:
        self.channel_id = channel_id
        self.message_count = 0
        self._type_name = type_name
        self._type_hash = type_hash
        self._qos_profiles = qos_profiles

    def summary(self, name: str) -> TopicSummary:
        return TopicSummary(
            name=name,
            type_name=self._type_name,
            type_hash=self._type_hash,
            qos_profiles=self._qos_profiles,
            message_count=self.message_count,
        )


_COMPRESSIONS: dict[str, CompressionType] = {
    "none": CompressionType.NONE,
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
}


def _create(directory: Path, file: Path) -> IO[bytes]:
    try:
        directory.mkdir(parents=True)
        return file.open("xb")
    except FileExistsError as error:
        raise BagError(f"{directory} exists already; choose another name or move it") from error
    except OSError as error:
        raise BagError(
            f"{directory} cannot be created: {os_reason(error)}; choose a directory that you "
            "may write to"
        ) from error


def _write_in_one_piece(path: Path, text: str) -> None:
    temporary = path.with_name(f"{path.name}.tmp")
    with temporary.open("w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
    temporary.replace(path)

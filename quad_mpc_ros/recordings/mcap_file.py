# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading one MCAP file with the mcap library."""

from __future__ import annotations

import io
import zlib
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Footer, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from quad_mpc_ros import __version__
from quad_mpc_ros.configuration.errors import BagError, os_reason

METADATA_FILE = "metadata.yaml"
LATEST_NS = 2**63 - 1
"""The last time that rosbag2 can store [ns since the epoch]."""
MAGIC_SIZE = len(MCAP0_MAGIC)
LIBRARY = f"quad_mpc_ros {__version__}"
"""The library of the writer, in the header of a file."""
McapMessage = tuple[Schema | None, Channel, Message]


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
class TopicInfo:
    """One topic of a bag.

    ``encoding`` is the encoding of its messages, ``cdr`` in ROS 2. ``qos_profiles`` is YAML from
    rosbag2, one entry per publisher; it and ``type_hash`` are empty if missing in the bag.
    """

    type_name: str
    encoding: str
    message_count: int
    qos_profiles: str
    type_hash: str


class McapFile:
    """A finished MCAP file with an index.

    The file is read chunk by chunk, checksums are verified, and it is closed between calls. Every
    failure is a :class:`BagError` that names the file.
    """

    def __init__(self, path: Path) -> None:
        """Read the index of ``path``.

        Raises :class:`BagError` for a file without an end or without an index.
        """
        self.path = path
        with _opened(path) as stream:
            stream.seek(-MAGIC_SIZE, io.SEEK_END)
            is_finished = stream.tell() > 0 and stream.read() == MCAP0_MAGIC
            stream.seek(0)
            reader = SeekingReader(stream, validate_crcs=True)
            summary = reader.get_summary() if is_finished else None
            if summary is None or summary.statistics is None:
                raise unfinished(path)
            if len(summary.channels) < summary.statistics.channel_count:
                raise unfinished(path)
            self.summary: Summary = summary
            self.statistics: Statistics = summary.statistics
            self.metadata = list(reader.iter_metadata())
            # By rosbag2's copy of metadata.yaml.
            texts = [each.metadata.get("serialized_metadata", "") for each in self.metadata]
            if any("compression_mode: message" in text.lower() for text in texts):
                raise OtherFormatError(path, "has messages compressed by rosbag2", _bag_of(path))

    @property
    def span(self) -> TimeSpan | None:
        """The log times of the first and the last message; None without messages."""
        if not self.statistics.message_count:
            return None
        return TimeSpan(
            start_ns=self.statistics.message_start_time, end_ns=self.statistics.message_end_time
        )

    def verify(self) -> None:
        """Read the whole file.

        Raises :class:`BagError` if a checksum is wrong, and for a chunk whose messages have no
        index: ``ros2 bag play`` cannot put them in order.
        """
        with _opened(self.path) as stream:
            for chunk in self.summary.chunk_indexes:
                if not chunk.message_index_offsets and chunk.message_end_time > 0:
                    raise ValueError("a chunk without an index of its messages")
            _check_summary(stream)
            reader = StreamReader(stream, emit_chunks=True, validate_crcs=True)
            for record in reader.records:
                if isinstance(record, Chunk):
                    get_chunk_data_stream(record, validate_crc=True)

    def messages(
        self, topics: Collection[str] | None = None, *, from_ns: int = 0
    ) -> Iterator[McapMessage]:
        """Yield messages of ``topics`` (default: all) from a log time on, in log-time order."""
        with _opened(self.path) as stream:
            reader = SeekingReader(stream, validate_crcs=True)
            yield from reader.iter_messages(topics, starting_at=from_ns)


def unfinished(path: Path) -> BagError:
    """Return the error for an interrupted recording without end or index."""
    return BagError(f"{path}: is unfinished; complete it: {repair_command(path)}")


def repair_command(path: Path) -> str:
    """Return the command that repairs a bag, or the bag of a file."""
    return f"quad_mpc bag repair {_bag_of(path)}"


def _bag_of(path: Path) -> Path:
    return path.parent if (path.parent / METADATA_FILE).exists() else path


def united_span(files: Iterable[McapFile]) -> TimeSpan | None:
    """Return the log times of the first and the last message in files; None without messages."""
    spans = [file.span for file in files if file.span is not None]
    if not spans:
        return None
    return TimeSpan(
        start_ns=min(span.start_ns for span in spans), end_ns=max(span.end_ns for span in spans)
    )


def topics_in(files: Iterable[McapFile]) -> dict[str, TopicInfo]:
    """Return every topic of some files by name, including topics without messages."""
    found: dict[str, TopicInfo] = {}
    for file in files:
        for channel_id, channel in file.summary.channels.items():
            schema = file.summary.schemas.get(channel.schema_id)
            count = file.statistics.channel_message_counts.get(channel_id, 0)
            known = found.get(channel.topic)
            found[channel.topic] = TopicInfo(
                type_name=schema.name if schema else "",
                encoding=channel.message_encoding,
                message_count=count + (known.message_count if known else 0),
                qos_profiles=channel.metadata.get("offered_qos_profiles", ""),
                type_hash=channel.metadata.get("topic_type_hash", ""),
            )
    return found


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as stream:
            _check_magic(stream, path)
            yield stream
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {os_reason(error)}") from error
    except BagError:
        raise
    # The parsers of mcap, zstd and lz4 raise anything on damaged bytes.
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise BagError(f"{path}: is corrupt: {type(error).__name__}: {reason}") from error


CONVERT = "rosbags-convert --src {} --dst {} --dst-storage mcap"
"""Command that converts ROS 1 bags, other storages and compressed bags; part of rosbags."""
_OTHER_FORMATS = {b"SQLite format 3": "is an SQLite bag", b"#ROSBAG V2.0": "is a ROS 1 bag"}


class OtherFormatError(BagError):
    """An intact bag that must be converted before reading."""

    def __init__(self, place: Path, reason: str, *sources: Path) -> None:
        target = sources[0].with_name(f"{sources[0].stem}_mcap")
        command = CONVERT.format(" ".join(map(str, sources)), target)
        super().__init__(f"{place}: {reason}, expected MCAP; convert it: {command}")


def _check_magic(stream: BinaryIO, path: Path) -> None:
    start = stream.read(MAGIC_SIZE)
    if not start:
        raise BagError(f"{path}: is empty")
    known = next((name for begin, name in _OTHER_FORMATS.items() if start == begin[:8]), None)
    if known is not None:
        raise OtherFormatError(path, known, path)
    if start != MCAP0_MAGIC:
        raise BagError(f"{path}: is not an MCAP file")
    stream.seek(0)


_FOOTER_SIZE = 29
_CHECKSUM_SIZE = 4


def _check_summary(stream: BinaryIO) -> None:
    """Check the checksum of a finished file's index, which the mcap library ignores."""
    end = stream.seek(-MAGIC_SIZE - _FOOTER_SIZE, io.SEEK_END)
    footer = next(StreamReader(stream, skip_magic=True).records)
    if not isinstance(footer, Footer):
        raise ValueError("no footer at the end")
    if footer.summary_crc:
        start = footer.summary_start or end
        stream.seek(start)
        content = stream.read(end + _FOOTER_SIZE - _CHECKSUM_SIZE - start)
        if zlib.crc32(content) != footer.summary_crc:
            raise ValueError("wrong checksum of the index")
    stream.seek(0)

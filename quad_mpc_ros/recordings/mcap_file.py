"""Reading one MCAP file, whether its writer finished it or not."""

from __future__ import annotations

import io
import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.recordings.bag_metadata import TimeSpan, extended


@dataclass
class McapContents:
    """What a file holds besides the messages themselves."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    message_counts: Counter[int] = field(default_factory=Counter)
    span: TimeSpan | None = None
    metadata: list[Metadata] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True, eq=False)
class McapMessage:
    """One message with the channel it came by."""

    channel: Channel
    schema: Schema | None
    message: Message


class McapFile:
    """One MCAP file.

    A file with an index is read by it. A file without, as SIGKILL leaves it, is read from the
    start up to its last whole record, and held in memory while its messages are put in order.
    A file that is compressed as a whole (``.mcap.zstd``) is unpacked into a temporary one each
    time. Checksums are verified. Every failure is a :class:`BagError` that names the file.
    """

    def __init__(self, path: Path) -> None:
        """Open ``path`` for a first look; no file stays open.

        ``finished`` tells whether the writer ended the file, be it without an index.
        """
        self.path = path
        with _opened(path) as stream:
            self.finished = _is_finished(stream)
            contents = _indexed_contents(stream) if self.finished else None
            self._indexed = contents is not None
            self.contents = contents or _scanned_contents(stream)

    def verify(self) -> None:
        """Read the whole file; raise :class:`BagError` when a checksum is wrong."""
        with _opened(self.path) as stream:
            _check_summary(stream)
            reader = StreamReader(
                stream, emit_chunks=True, validate_crcs=True, record_size_limit=_size_of(stream)
            )
            for record in reader.records:
                if isinstance(record, Chunk):
                    get_chunk_data_stream(record, validate_crc=True)

    def messages(
        self, topics: Collection[str] | None = None, *, from_ns: int = 0
    ) -> Iterator[McapMessage]:
        """Yield the messages of ``topics`` (all by default) from a log time on, in its order."""
        with _opened(self.path) as stream:
            if self._indexed:
                reader = SeekingReader(
                    stream, validate_crcs=True, record_size_limit=_size_of(stream)
                )
                for schema, channel, message in reader.iter_messages(topics, starting_at=from_ns):
                    yield McapMessage(channel=channel, schema=schema, message=message)
            else:
                for found in _scanned_messages(stream, topics):
                    if found.message.log_time >= from_ns:
                        yield found


_MAGIC_SIZE = len(MCAP0_MAGIC)
_RECORD_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_CHECKSUM_SIZE = 4


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as stream, _unpacked(stream) as unpacked:
            _check_magic(unpacked)
            yield unpacked
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {os_reason(error)}") from error
    except _NotMcapError as error:
        raise BagError(f"{path}: {error}") from error
    # The parsers of mcap, zstd and lz4 raise what they please on bytes that were tampered with.
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise BagError(f"{path}: is corrupt: {type(error).__name__}: {reason}") from error


@contextmanager
def _unpacked(stream: BinaryIO) -> Iterator[BinaryIO]:
    """Yield ``stream``, or what is in it when it is compressed as a whole."""
    packed = stream.read(len(zstandard.FRAME_HEADER)) == zstandard.FRAME_HEADER
    stream.seek(0)
    if not packed:
        yield stream
        return
    with tempfile.TemporaryFile() as unpacked:
        zstandard.ZstdDecompressor().copy_stream(stream, unpacked)
        unpacked.seek(0)
        yield unpacked


class _NotMcapError(Exception):
    pass


def _check_magic(stream: BinaryIO) -> None:
    start = stream.read(_MAGIC_SIZE)
    if not start:
        raise _NotMcapError("is empty")
    if start != MCAP0_MAGIC:
        raise _NotMcapError("is not an MCAP file")
    stream.seek(0)


def _size_of(stream: BinaryIO) -> int:
    position = stream.tell()
    size = stream.seek(0, io.SEEK_END)
    stream.seek(position)
    return size


def _check_summary(stream: BinaryIO) -> None:
    """Check the checksum of a finished file's index, which the reader of mcap passes over."""
    start = stream.seek(-_MAGIC_SIZE - _FOOTER.size, io.SEEK_END)
    opcode, _, summary_start, _, checksum = _FOOTER.unpack(stream.read(_FOOTER.size))
    if opcode != Opcode.FOOTER:
        raise ValueError("no footer at the end")
    if checksum:
        stream.seek(summary_start or start)
        end = start + _FOOTER.size - _CHECKSUM_SIZE
        if zlib.crc32(stream.read(end - stream.tell())) != checksum:
            raise ValueError("wrong checksum of the index")
    stream.seek(0)


def _is_finished(stream: BinaryIO) -> bool:
    size = stream.seek(-_MAGIC_SIZE, io.SEEK_END) + _MAGIC_SIZE
    end = stream.read(_MAGIC_SIZE)
    stream.seek(0)
    return end == MCAP0_MAGIC and size > _MAGIC_SIZE


def _indexed_contents(stream: BinaryIO) -> McapContents | None:
    """Return the contents by the file's index, or None for a file that has none."""
    size = _size_of(stream)
    reader = SeekingReader(stream, validate_crcs=True, record_size_limit=size)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    statistics = summary.statistics
    if len(summary.channels) < statistics.channel_count:
        return None
    if not summary.chunk_indexes and statistics.message_count:
        return None
    return McapContents(
        schemas=summary.schemas,
        channels=summary.channels,
        message_counts=Counter(statistics.channel_message_counts),
        span=_span_of(statistics),
        metadata=list(reader.iter_metadata()),
    )


def _scanned_contents(stream: BinaryIO) -> McapContents:
    contents = McapContents()
    for record in _whole_records(stream):
        if isinstance(record, Schema):
            contents.schemas[record.id] = record
        elif isinstance(record, Channel):
            contents.channels[record.id] = record
        elif isinstance(record, Metadata):
            contents.metadata.append(record)
        elif isinstance(record, Message):
            contents.message_counts[record.channel_id] += 1
            contents.span = extended(contents.span, record.log_time)
    return contents


def _scanned_messages(stream: BinaryIO, topics: Collection[str] | None) -> Iterator[McapMessage]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    found = []
    for record in _whole_records(stream):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            if topics is None or channel.topic in topics:
                schema = schemas.get(channel.schema_id)
                found.append(McapMessage(channel=channel, schema=schema, message=record))
    yield from sorted(found, key=lambda item: item.message.log_time)


def _whole_records(stream: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of a file up to its end, or to where its writer was stopped."""
    end = _end_of_whole_records(stream)
    stream.seek(_MAGIC_SIZE)
    whole = io.BytesIO(stream.read(end - _MAGIC_SIZE))
    reader = StreamReader(whole, skip_magic=True, validate_crcs=True, record_size_limit=end)
    # Cut after a whole record, the input cannot end anywhere else.
    with suppress(EndOfFile):
        yield from reader.records


def _end_of_whole_records(stream: BinaryIO) -> int:
    size = _size_of(stream)
    position = _MAGIC_SIZE
    while position + _RECORD_HEAD.size <= size:
        stream.seek(position)
        _, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
        following = position + _RECORD_HEAD.size + length
        if following > size:
            break
        position = following
    return position


def _span_of(statistics: Statistics) -> TimeSpan | None:
    if statistics.message_count == 0:
        return None
    return TimeSpan(start_ns=statistics.message_start_time, end_ns=statistics.message_end_time)

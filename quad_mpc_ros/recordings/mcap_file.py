"""Reading one MCAP file, whether its writer finished it or not."""

from __future__ import annotations

import heapq
import io
import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.recordings.bag_metadata import TimeSpan, extended, united
from quad_mpc_ros.recordings.mcap_records import (
    RECORD_HEAD,
    records_in,
    records_of_cut_chunk,
    size_of,
)


@dataclass(frozen=True, kw_only=True)
class _Piece:
    """A part of a file that is read at once: a chunk, or some records that are in none."""

    start: int
    size: int
    span: TimeSpan
    channels: Collection[int]
    """Of its messages; empty when unknown."""


@dataclass
class McapContents:
    """What a file holds besides the messages themselves, and the pieces that hold those."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    message_counts: Counter[int] = field(default_factory=Counter)
    span: TimeSpan | None = None
    metadata: list[Metadata] = field(default_factory=list)
    pieces: list[_Piece] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True, eq=False)
class McapMessage:
    """One message with the channel it came by."""

    channel: Channel
    schema: Schema | None
    message: Message


class McapFile:
    """One MCAP file.

    A file with an index is read by it. One without, as SIGKILL leaves it, is scanned from the
    start up to its last whole record, those of a chunk that was cut included, which makes an
    index. Messages are read piece by piece, so
    that the memory needed is that of a chunk and of those that overlap it in time. A file that is
    compressed as a whole (``.mcap.zstd``) is unpacked into a temporary one each time. Checksums
    are verified. Every failure is a :class:`BagError` that names the file.
    """

    def __init__(self, path: Path) -> None:
        """Open ``path`` for a first look; no file stays open.

        ``finished``: whether the writer ended the file, with or without an index.
        """
        self.path = path
        with _opened(path) as stream:
            self.finished = _is_finished(stream)
            self._indexed = _indexed_contents(stream) if self.finished else None

    @cached_property
    def contents(self) -> McapContents:
        """The index, or a scan of the whole file where there is none."""
        if self._indexed is not None:
            return self._indexed
        with _opened(self.path) as stream:
            return _scanned_contents(stream)

    def verify(self) -> None:
        """Read the whole file; raise :class:`BagError` when a checksum is wrong."""
        with _opened(self.path) as stream:
            _check_summary(stream)
            reader = StreamReader(
                stream, emit_chunks=True, validate_crcs=True, record_size_limit=size_of(stream)
            )
            for record in reader.records:
                if isinstance(record, Chunk):
                    get_chunk_data_stream(record, validate_crc=True)

    def messages(
        self, topics: Collection[str] | None = None, *, from_ns: int = 0
    ) -> Iterator[McapMessage]:
        """Yield the messages of ``topics`` (all by default) from a log time on, in its order."""
        contents = self.contents
        wanted = {
            number: topics is None or channel.topic in topics
            for number, channel in contents.channels.items()
        }
        pieces = [
            piece
            for piece in contents.pieces
            if piece.span.end_ns >= from_ns
            and (not piece.channels or any(wanted.get(number) for number in piece.channels))
        ]
        with _opened(self.path) as stream:
            for message in _in_order(stream, pieces, wanted):
                if message.log_time >= from_ns:
                    channel = contents.channels[message.channel_id]
                    schema = contents.schemas.get(channel.schema_id)
                    yield McapMessage(channel=channel, schema=schema, message=message)


_MAGIC_SIZE = len(MCAP0_MAGIC)
_FOOTER = struct.Struct("<BQQQI")
_CHECKSUM_SIZE = 4
_PIECE_SIZE = 2**20


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
    # The parsers of mcap, zstd and lz4 raise anything on damaged bytes.
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
    size = size_of(stream)
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
        span=TimeSpan(start_ns=statistics.message_start_time, end_ns=statistics.message_end_time)
        if statistics.message_count
        else None,
        metadata=list(reader.iter_metadata()),
        pieces=[
            _Piece(
                start=chunk.chunk_start_offset,
                size=chunk.chunk_length,
                span=TimeSpan(start_ns=chunk.message_start_time, end_ns=chunk.message_end_time),
                channels=chunk.message_index_offsets.keys(),
            )
            for chunk in summary.chunk_indexes
        ],
    )


def _scanned_contents(stream: BinaryIO) -> McapContents:
    contents = McapContents()
    for start, size in _pieces_of_whole_records(stream):
        span: TimeSpan | None = None
        channels = set()
        for record in _records(stream, start, size):
            if isinstance(record, Schema):
                contents.schemas[record.id] = record
            elif isinstance(record, Channel):
                contents.channels[record.id] = record
            elif isinstance(record, Metadata):
                contents.metadata.append(record)
            elif isinstance(record, Message):
                contents.message_counts[record.channel_id] += 1
                channels.add(record.channel_id)
                span = extended(span, record.log_time)
        if span is not None:
            contents.span = united((contents.span, span))
            contents.pieces.append(_Piece(start=start, size=size, span=span, channels=channels))
    return contents


def _pieces_of_whole_records(stream: BinaryIO) -> Iterator[tuple[int, int]]:
    """Yield start and size of parts of a file up to its end, or to where its writer was stopped.

    Each is a chunk, of which the last may be cut, or records outside of chunks, as many as make a
    mebibyte.
    """
    size = size_of(stream)
    start = position = _MAGIC_SIZE
    while position + RECORD_HEAD.size <= size:
        stream.seek(position)
        opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
        following = position + RECORD_HEAD.size + length
        if following > size:
            if opcode == Opcode.CHUNK:
                if position > start:
                    yield start, position - start
                yield position, size - position
                return
            break
        if opcode == Opcode.CHUNK:
            if position > start:
                yield start, position - start
            yield position, following - position
            start = following
        elif following - start >= _PIECE_SIZE:
            yield start, following - start
            start = following
        position = following
    if position > start:
        yield start, position - start


def _in_order(
    stream: BinaryIO, pieces: Iterable[_Piece], wanted: Mapping[int, bool]
) -> Iterator[Message]:
    """Yield the messages of pieces by log time; those of the same time as they are in the file.

    ``wanted``: by channel. Memory holds the messages of one piece and of those that it overlaps
    in time.
    """
    ahead: list[tuple[int, int, int, Message]] = []
    for piece in sorted(pieces, key=lambda piece: (piece.span.start_ns, piece.start)):
        while ahead and ahead[0][0] < piece.span.start_ns:
            yield heapq.heappop(ahead)[-1]
        for number, record in enumerate(_records(stream, piece.start, piece.size)):
            if isinstance(record, Message) and wanted[record.channel_id]:
                heapq.heappush(ahead, (record.log_time, piece.start, number, record))
    while ahead:
        yield heapq.heappop(ahead)[-1]


def _records(stream: BinaryIO, start: int, size: int) -> Iterator[McapRecord]:
    """Yield the records in a part of a file, those in a chunk one by one."""
    stream.seek(start)
    content = stream.read(min(size, size_of(stream) - start))
    opcode, length = RECORD_HEAD.unpack_from(content)
    if opcode == Opcode.CHUNK and length > len(content) - RECORD_HEAD.size:
        stream.seek(start + RECORD_HEAD.size)
        yield from records_of_cut_chunk(stream, start + len(content))
    else:
        yield from records_in(content)

"""Reading one MCAP file with the mcap library, whether its writer finished it or not."""

from __future__ import annotations

import io
import tempfile
import weakref
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.recordings.bag_metadata import TimeSpan
from quad_mpc_ros.recordings.mcap_records import MAGIC_SIZE, WholeRecords, copy_records

McapMessage = tuple[Schema | None, Channel, Message]


@dataclass(frozen=True, kw_only=True)
class McapContents:
    """What a file holds besides the messages themselves."""

    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    message_counts: Counter[int]
    span: TimeSpan | None
    metadata: Sequence[Metadata]


class McapFile:
    """One MCAP file.

    A file with an index is read chunk by chunk. A file without an index, as SIGKILL leaves it, is
    first copied up to its last whole record into a temporary one with an index. A file that is
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
        """What the file holds."""
        if self._indexed is not None:
            return self._indexed
        with _opened(self._path_with_index) as stream:
            contents = _indexed_contents(stream)
        assert contents is not None  # of the copy
        return contents

    @cached_property
    def _path_with_index(self) -> Path:
        """The file itself, or a copy that is there as long as this object."""
        if self._indexed is not None:
            return self.path
        with _opened(self.path) as stream:
            copy = tempfile.NamedTemporaryFile(suffix=".mcap")  # noqa: SIM115, closed below
            weakref.finalize(self, copy.close)
            records = WholeRecords(stream)
            copy_records(records, Writer(copy, compression=CompressionType.NONE))
            copy.flush()
            if records.damaged_chunks:
                raise ValueError(f"{records.damaged_chunks} damaged chunks")
        return Path(copy.name)

    def verify(self) -> None:
        """Read the whole file.

        Raises :class:`BagError` when a checksum is wrong, and for a chunk whose messages have no
        index: ``ros2 bag play`` cannot put them in order.
        """
        with _opened(self.path) as stream:
            summary = _reader(stream).get_summary()
            for chunk in summary.chunk_indexes if summary else ():
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
        """Yield the messages of ``topics`` (all by default) from a log time on, in its order."""
        with _opened(self._path_with_index) as stream:
            yield from _reader(stream).iter_messages(topics, starting_at=from_ns)


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as stream, _unpacked(stream) as unpacked:
            _check_magic(unpacked, path)
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


CONVERT = "rosbags-convert --src {} --dst {} --dst-storage mcap"
"""Converts bags of ROS 1 and of other storages; the library rosbags installs it."""
_OTHER_FORMATS = {b"SQLite format 3": "an SQLite bag", b"#ROSBAG V2.0": "a ROS 1 bag"}


def conversion(reason: str, *sources: Path) -> str:
    """Return why bags cannot be read, and the command that converts them."""
    target = sources[0].with_name(f"{sources[0].stem}_mcap")
    command = CONVERT.format(" ".join(map(str, sources)), target)
    return f"{reason}, expected MCAP; convert it: {command}"


def _check_magic(stream: BinaryIO, path: Path) -> None:
    start = stream.read(MAGIC_SIZE)
    if not start:
        raise _NotMcapError("is empty")
    known = next((name for begin, name in _OTHER_FORMATS.items() if start == begin[:8]), None)
    if known is not None:
        raise _NotMcapError(conversion(f"is {known}", path))
    if start != MCAP0_MAGIC:
        raise _NotMcapError("is not an MCAP file")
    stream.seek(0)


_FOOTER_SIZE = 29
_CHECKSUM_SIZE = 4


def _check_summary(stream: BinaryIO) -> None:
    """Check the checksum of a finished file's index, which the mcap library passes over."""
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


def _is_finished(stream: BinaryIO) -> bool:
    size = stream.seek(-MAGIC_SIZE, io.SEEK_END) + MAGIC_SIZE
    end = stream.read(MAGIC_SIZE)
    stream.seek(0)
    return end == MCAP0_MAGIC and size > MAGIC_SIZE


def _reader(stream: BinaryIO) -> SeekingReader:
    return SeekingReader(stream, validate_crcs=True)


def _indexed_contents(stream: BinaryIO) -> McapContents | None:
    """Return the contents by the file's index, or None for a file that has none."""
    reader = _reader(stream)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    statistics = summary.statistics
    if len(summary.channels) < statistics.channel_count:
        return None
    if not summary.chunk_indexes and statistics.message_count:
        return None
    span = TimeSpan(start_ns=statistics.message_start_time, end_ns=statistics.message_end_time)
    return McapContents(
        schemas=summary.schemas,
        channels=summary.channels,
        message_counts=Counter(statistics.channel_message_counts),
        span=span if statistics.message_count else None,
        metadata=list(reader.iter_metadata()),
    )

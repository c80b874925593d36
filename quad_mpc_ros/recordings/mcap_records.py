"""The records in the bytes of an MCAP file, also of a chunk that was cut."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO

import zstandard
from mcap.exceptions import EndOfFile
from mcap.records import McapRecord
from mcap.stream_reader import StreamReader

RECORD_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")  # start and end time, size, checksum, length of a name
_LENGTH = struct.Struct("<Q")
_BLOCK = 2**20


def size_of(stream: BinaryIO) -> int:
    """Return the size of a file, which stays where it is."""
    position = stream.tell()
    size = stream.seek(0, io.SEEK_END)
    stream.seek(position)
    return size


def records_in(content: bytes) -> Iterator[McapRecord]:
    """Yield the records in a content that ends after a whole one, those in a chunk one by one."""
    reader = StreamReader(
        io.BytesIO(content), skip_magic=True, validate_crcs=True, record_size_limit=len(content)
    )
    with suppress(EndOfFile):  # where the next record would begin
        yield from reader.records


def records_of_cut_chunk(stream: BinaryIO, end: int) -> Iterator[McapRecord]:
    """Yield what is whole of a chunk in which a file ends, at ``end``.

    The stream is where its content begins, after the head of its record.
    """
    # Zeros may be data or never written: better to lose a record than to invent one.
    end = _end_without_zeros(stream, end)
    waiting = b""
    try:
        for part in _content_of_cut_chunk(stream, end):
            waiting += part
            position = 0
            while (following := _end_of_record(waiting, position)) is not None:
                yield from records_in(waiting[position:following])
                position = following
            waiting = waiting[position:]
    except Exception:  # whatever mcap and zstd raise on damaged bytes
        return


def _end_of_record(content: bytes, start: int) -> int | None:
    if start + RECORD_HEAD.size > len(content):
        return None
    _, length = RECORD_HEAD.unpack_from(content, start)
    end: int = start + RECORD_HEAD.size + length
    return end if end <= len(content) else None


def _content_of_cut_chunk(stream: BinaryIO, end: int) -> Iterator[bytes]:
    """Yield the uncompressed content of a chunk, block by block, up to the end of what is there.

    No more than the chunk is said to hold: what follows is another's.
    """
    head = stream.read(_CHUNK_HEAD.size)
    _, _, left, _, name_length = _CHUNK_HEAD.unpack(head)
    compression = stream.read(min(name_length, end))
    stream.seek(_LENGTH.size, io.SEEK_CUR)
    if compression not in (b"zstd", b""):
        return
    decompressor = zstandard.ZstdDecompressor().decompressobj() if compression else None
    while left > 0 and (block := stream.read(max(0, min(_BLOCK, end - stream.tell())))):
        content = decompressor.decompress(block) if decompressor else block
        yield content[:left]
        left -= len(content)


def _end_without_zeros(stream: BinaryIO, end: int) -> int:
    """Return where the zeros at the end of a file begin, and stay where the stream is."""
    start = stream.tell()
    while end > start:
        size = min(_BLOCK, end - start)
        stream.seek(end - size)
        kept = len(stream.read(size).rstrip(b"\0"))
        end -= size - kept
        if kept:
            break
    stream.seek(start)
    return end

"""Reading what can be read of a damaged MCAP file."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from typing import BinaryIO

import zstandard
from mcap.opcode import Opcode
from mcap.records import McapRecord
from mcap.writer import MCAP0_MAGIC

from quad_mpc_ros.recordings.mcap_file import RECORD_HEAD, records_in, size_of

_CHUNK_HEAD = struct.Struct("<QQQII")  # start and end time, size, checksum, length of a name
_LENGTH = struct.Struct("<Q")
_BLOCK = 2**20


class Salvage:
    """The records of a file, as far as they are whole.

    A chunk with a wrong checksum or content is left out; of one cut by the end of the file, the
    whole records are kept, unless its compression is lz4. The index at the end
    of a file is not read, nor anything after it.
    """

    def __init__(self, stream: BinaryIO) -> None:
        """Look at an MCAP file, positioned anywhere, that begins as one must."""
        self._stream = stream
        self.damaged_chunks = 0
        """Chunks left out so far."""
        self.read_up_to = len(MCAP0_MAGIC)
        """The end of the last whole record so far [bytes from the start]."""

    def records(self) -> Iterator[McapRecord]:
        """Yield the records in the order of the file, those in chunks one by one."""
        end = size_of(self._stream)
        self._stream.seek(len(MCAP0_MAGIC))
        while len(head := self._stream.read(RECORD_HEAD.size)) == RECORD_HEAD.size:
            opcode, length = RECORD_HEAD.unpack(head)
            if opcode in _ENDINGS:
                return
            if length > end - self._stream.tell():  # a damaged length may be astronomic
                if opcode == Opcode.CHUNK:
                    yield from _records_of_cut_chunk(self._stream, end)
                return
            body = self._stream.read(length)
            self.read_up_to += RECORD_HEAD.size + length
            try:
                yield from list(records_in(head + body))
            except Exception:  # whatever mcap, zstd and lz4 raise on damaged bytes
                self.damaged_chunks += 1


# Zeros are what a file system leaves of data that it never wrote.
_ENDINGS = (0, Opcode.DATA_END, Opcode.FOOTER)


def _records_of_cut_chunk(stream: BinaryIO, end: int) -> Iterator[McapRecord]:
    """Yield what is whole of a chunk in which a file ends, at ``end``."""
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

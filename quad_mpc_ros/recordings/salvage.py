"""Reading what can be read of a damaged MCAP file."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO

import zstandard
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import McapRecord
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")  # start and end time, size, checksum, length of a name
_LENGTH = struct.Struct("<Q")


class Salvage:
    """The records of a file, as far as they are whole.

    A chunk whose checksum or content is wrong is left out; of the one at which the file ends, the
    records are given that were written whole, unless its compression is lz4. The index at the end
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
        self._stream.seek(len(MCAP0_MAGIC))
        while len(head := self._stream.read(_HEAD.size)) == _HEAD.size:
            opcode, length = _HEAD.unpack(head)
            if opcode in _ENDINGS:
                return
            body = self._read(length)
            if len(body) < length:
                if opcode == Opcode.CHUNK:
                    yield from _records_of_cut_chunk(body)
                return
            self.read_up_to += _HEAD.size + length
            try:
                yield from _parsed(head + body)
            except Exception:  # whatever mcap, zstd and lz4 raise on damaged bytes
                self.damaged_chunks += 1

    def _read(self, length: int) -> bytes:
        """Return ``length`` bytes, or what there is: a damaged length may be astronomic."""
        position = self._stream.tell()
        available = self._stream.seek(0, io.SEEK_END) - position
        self._stream.seek(position)
        return self._stream.read(min(length, available))


# Zeros are what a file system leaves of data that it never wrote.
_ENDINGS = (0, Opcode.DATA_END, Opcode.FOOTER)


def _parsed(record: bytes) -> list[McapRecord]:
    reader = StreamReader(
        io.BytesIO(record), skip_magic=True, validate_crcs=True, record_size_limit=len(record)
    )
    found: list[McapRecord] = []
    with suppress(EndOfFile):  # where the next record would begin
        found.extend(reader.records)
    return found


def _records_of_cut_chunk(body: bytes) -> Iterator[McapRecord]:
    try:
        # Zeros may be data or what was never written: better to lose one record than to make
        # one up.
        content = _content_of_cut_chunk(body.rstrip(b"\0"))
    except Exception:  # whatever zstd raises on damaged bytes
        return
    position = 0
    while position + _HEAD.size <= len(content):
        _, length = _HEAD.unpack_from(content, position)
        end = position + _HEAD.size + length
        if end > len(content):
            return
        try:
            yield from _parsed(content[position:end])
        except Exception:  # whatever mcap raises on damaged bytes
            return
        position = end


def _content_of_cut_chunk(body: bytes) -> bytes:
    """Return the uncompressed beginning of a chunk's content."""
    name_length = _CHUNK_HEAD.unpack_from(body)[-1]
    start = _CHUNK_HEAD.size + name_length + _LENGTH.size
    compression = body[_CHUNK_HEAD.size : _CHUNK_HEAD.size + name_length]
    data = body[start:]
    if compression == b"zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    return data if not compression else b""

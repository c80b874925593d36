"""Reading what can be read of a damaged MCAP file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import McapRecord
from mcap.writer import MCAP0_MAGIC

from quad_mpc_ros.recordings.mcap_records import (
    RECORD_HEAD,
    records_in,
    records_of_cut_chunk,
    size_of,
)


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
                    yield from records_of_cut_chunk(self._stream, end)
                return
            body = self._stream.read(length)
            self.read_up_to += RECORD_HEAD.size + length
            try:
                yield from list(records_in(head + body))
            except Exception:  # whatever mcap, zstd and lz4 raise on damaged bytes
                self.damaged_chunks += 1


# Zeros are what a file system leaves of data that it never wrote.
_ENDINGS = (0, Opcode.DATA_END, Opcode.FOOTER)

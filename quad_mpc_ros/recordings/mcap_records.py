"""The records of an MCAP file in the order of the file, as far as they are whole, and a copy."""

from __future__ import annotations

import io
import itertools
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, Writer

from quad_mpc_ros import __version__

LIBRARY = f"quad_mpc_ros {__version__}"
"""What wrote a file, in its header."""
MAGIC_SIZE = len(MCAP0_MAGIC)
_HEAD = struct.Struct("<BQ")  # opcode, length
_ENDINGS = (0, Opcode.DATA_END, Opcode.FOOTER)


class WholeRecords:
    """The records of a file that are whole, those in chunks one by one.

    A chunk with a wrong checksum or content is left out. The whole records of a chunk that the
    end of the file cuts are kept, unless lz4 compresses the chunk. The index is not read.
    """

    def __init__(self, stream: BinaryIO) -> None:
        """Take an MCAP file, positioned anywhere, that begins as one must."""
        self._stream = stream
        self.damaged_chunks = 0
        """Chunks left out so far."""
        self.read_up_to = MAGIC_SIZE
        """The end of the last whole record so far [bytes from the start]."""

    def __iter__(self) -> Iterator[McapRecord]:
        size = self._stream.seek(0, io.SEEK_END)
        self._stream.seek(MAGIC_SIZE)
        while len(head := self._stream.read(_HEAD.size)) == _HEAD.size:
            opcode, length = _HEAD.unpack(head)
            if opcode in _ENDINGS:
                return
            body = self._stream.read(min(length, size))  # a damaged length can be astronomic
            if len(body) < length:
                if opcode == Opcode.CHUNK:
                    yield from _records_of_cut_chunk(body)
                return
            self.read_up_to += _HEAD.size + length
            try:
                yield from list(_records(head + body))
            except Exception:  # the parsers of mcap, zstd and lz4 raise anything on damaged bytes
                self.damaged_chunks += 1


def _records(content: bytes) -> Iterator[McapRecord]:
    """Yield the whole records in a content."""
    reader = StreamReader(io.BytesIO(content), skip_magic=True, validate_crcs=True)
    with suppress(EndOfFile):
        yield from reader.records


def _records_of_cut_chunk(body: bytes) -> Iterator[McapRecord]:
    """Yield the whole records in the beginning of a chunk."""
    # Zeros may be data or never written: better to lose a record than to invent one.
    body = body.rstrip(b"\0")
    with suppress(Exception):  # as above
        chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
        content = chunk.data
        if chunk.compression == "zstd":
            content = zstandard.ZstdDecompressor().decompressobj().decompress(content)
        elif chunk.compression:
            return
        # A chunk holds no more than its size: the rest belongs to another record.
        yield from _records(content[: chunk.uncompressed_size])


def copy_records(
    records: Iterable[McapRecord],
    writer: Writer,
    *,
    corrected: Callable[[Message], Message] = lambda message: message,
) -> int:
    """Write the records of a file into a new one with an index; return the number of messages.

    Schemas and channels may get other numbers.
    """
    count, schema_ids, channel_ids = 0, {0: 0}, dict[int, int]()  # 0 is no schema
    remaining = iter(records)
    first = next(remaining, None)
    writer.start(profile=first.profile if isinstance(first, Header) else "ros2", library=LIBRARY)
    for record in itertools.chain((first,), remaining):
        if isinstance(record, Schema) and record.id not in schema_ids:
            schema_ids[record.id] = writer.register_schema(
                name=record.name, encoding=record.encoding, data=record.data
            )
        elif isinstance(record, Channel) and record.id not in channel_ids:
            channel_ids[record.id] = writer.register_channel(
                topic=record.topic,
                message_encoding=record.message_encoding,
                schema_id=schema_ids.get(record.schema_id, 0),
                metadata=record.metadata,
            )
        elif isinstance(record, Message) and record.channel_id in channel_ids:
            message = corrected(record)
            count += 1
            writer.add_message(
                channel_id=channel_ids[message.channel_id],
                log_time=message.log_time,
                data=message.data,
                publish_time=message.publish_time,
                sequence=message.sequence,
            )
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(
                create_time=record.create_time,
                log_time=record.log_time,
                name=record.name,
                media_type=record.media_type,
                data=record.data,
            )
    writer.finish()  # type: ignore[no-untyped-call]
    return count

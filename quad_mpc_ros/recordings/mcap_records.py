"""The complete records of an MCAP file in file order, and a copy of the file."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import BinaryIO

from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from quad_mpc_ros import __version__
from quad_mpc_ros.recordings.mcap_file import MAGIC_SIZE

LIBRARY = f"quad_mpc_ros {__version__}"
"""The library of the writer, in the header of a file."""
_HEAD = struct.Struct("<BQ")  # opcode, length
_ENDINGS = (0, Opcode.DATA_END, Opcode.FOOTER)


class WholeRecords:
    """The complete records of a file, also from inside chunks.

    A truncated chunk, or a chunk with a wrong checksum or content, is omitted. The index is not
    read.
    """

    def __init__(self, stream: BinaryIO) -> None:
        """Take an MCAP file with a valid beginning, at any position."""
        self._stream = stream
        self.damaged_chunks = 0
        """Omitted chunks so far."""

    def __iter__(self) -> Iterator[McapRecord]:
        size = self._stream.seek(0, io.SEEK_END)
        self._stream.seek(MAGIC_SIZE)
        while len(head := self._stream.read(_HEAD.size)) == _HEAD.size:
            opcode, length = _HEAD.unpack(head)
            if opcode in _ENDINGS:
                return
            body = self._stream.read(min(length, size))  # a damaged length can be astronomic
            if len(body) < length:
                return
            reader = StreamReader(io.BytesIO(head + body), skip_magic=True, validate_crcs=True)
            records: list[McapRecord] = []
            try:
                with suppress(EndOfFile):
                    records.extend(reader.records)
            except Exception:  # the parsers of mcap, zstd and lz4 raise anything on damaged bytes
                self.damaged_chunks += 1
            else:
                yield from records


def copy_records(records: Iterable[McapRecord], writer: Writer) -> int:
    """Write the records of a ROS 2 file into a new file; return the number of messages.

    Schemas and channels may get other numbers.
    """
    count, schema_ids, channel_ids = 0, {0: 0}, dict[int, int]()  # 0 is no schema
    writer.start(profile="ros2", library=LIBRARY)
    for record in records:
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
            count += 1
            writer.add_message(
                channel_id=channel_ids[record.channel_id],
                log_time=record.log_time,
                data=record.data,
                publish_time=record.publish_time,
                sequence=record.sequence,
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

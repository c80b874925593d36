# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Repair of an interrupted recording: index, ``metadata.yaml``."""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, Writer

from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.recordings.bag_metadata import bag_of, sync_directory, write_metadata
from quad_mpc_ros.recordings.mcap_file import (
    LIBRARY,
    MAGIC_SIZE,
    METADATA_FILE,
    McapFile,
    OtherFormatError,
    repair_command,
)
from quad_mpc_ros.recordings.reader import BagReader, mcap_files_in

_BROKEN_SUFFIX = ".broken"
_TEMPORARY_SUFFIX = ".repairing"
_HEAD = struct.Struct("<BQ")  # opcode, length
_ENDINGS = (0, Opcode.DATA_END, Opcode.FOOTER)


@dataclass(frozen=True, kw_only=True)
class RepairedFile:
    """The repair of one damaged file."""

    path: Path
    original: Path
    message_count: int
    damaged_chunks: int
    """Omitted chunks with a wrong checksum or content."""


def repair(path: Path) -> list[RepairedFile] | None:
    """Complete a bag that was left by a killed recorder or a power failure at ``path``.

    Each MCAP file without end, with a wrong checksum or without message index is rewritten from
    its complete records; the original is kept as ``<name>.broken``. ``metadata.yaml`` is written
    if a file was rewritten, or if it is missing, unusable or does not list the existing files; the
    old file is kept as ``metadata.yaml.broken``. An interrupted repair keeps the originals and can
    be repeated. An intact bag is not changed, and the result is None.

    Raises :class:`BagError` for anything but a bag, and for disk errors; the recording is never
    overwritten.

    The folder of a run has its bag in ``bag/``. A single MCAP file is repaired without
    ``metadata.yaml``; a file of a bag only with its bag.
    """
    directory = None
    if path.is_dir():
        directory = bag_of(path)
        _undo_interrupted_repair(directory)
        paths = mcap_files_in(directory)
    elif not path.is_file():
        raise BagError(f"{path}: is neither a bag directory nor an .mcap file")
    elif (path.parent / METADATA_FILE).exists():
        raise BagError(f"{path}: belongs to a bag; repair the bag: {repair_command(path)}")
    else:
        paths = [path]
    damaged = [each for each in paths if not _is_whole(each)]
    if not damaged and (directory is None or _is_complete(directory, paths)):
        return None
    try:
        repaired = [_repaired(each) for each in damaged]
        if directory is not None:
            _replace_metadata(directory, paths)
    except OSError as error:
        raise BagError(f"{path}: cannot be repaired: {os_reason(error)}") from error
    return repaired


def _undo_interrupted_repair(directory: Path) -> None:
    """Restore the name of an original if a repair was stopped between two renamings."""
    for original in directory.glob(f"*.mcap{_BROKEN_SUFFIX}"):
        path = original.with_name(original.name.removesuffix(_BROKEN_SUFFIX))
        if not path.exists():
            original.rename(path)


def _is_complete(directory: Path, paths: Sequence[Path]) -> bool:
    try:
        return sorted(BagReader(directory).files) == sorted(paths)
    except OtherFormatError:
        raise
    except BagError:
        return False


def _is_whole(path: Path) -> bool:
    try:
        McapFile(path).verify()
    except OtherFormatError:
        raise
    except BagError:
        return False
    return True


def _repaired(path: Path) -> RepairedFile:
    original = _place_for_original(path)
    temporary = path.with_name(f"{path.name}{_TEMPORARY_SUFFIX}")
    try:
        with path.open("rb") as damaged, temporary.open("wb") as stream:
            # An MCAP file may be truncated, or zeros, from its start.
            if not MCAP0_MAGIC.startswith(damaged.read(MAGIC_SIZE).rstrip(b"\0")):
                raise BagError(f"{path}: is not an MCAP file")
            records = WholeRecords(damaged)
            writer = Writer(stream, enable_data_crcs=True)
            message_count = _copy_records(records, writer)
            stream.flush()
            os.fsync(stream.fileno())
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    path.rename(original)
    temporary.replace(path)
    sync_directory(path.parent)
    return RepairedFile(
        path=path,
        original=original,
        message_count=message_count,
        damaged_chunks=records.damaged_chunks,
    )


def _place_for_original(path: Path) -> Path:
    original = path.with_name(f"{path.name}{_BROKEN_SUFFIX}")
    if original.exists():
        raise BagError(f"{original} exists already, from an earlier repair; move it away")
    return original


def _replace_metadata(directory: Path, paths: Sequence[Path]) -> None:
    """Write ``metadata.yaml``; keep the old file under another name."""
    path = directory / METADATA_FILE
    if path.exists():
        path.rename(_place_for_original(path))
    write_metadata(directory, [McapFile(each) for each in paths])
    sync_directory(directory)


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


def _copy_records(records: Iterable[McapRecord], writer: Writer) -> int:
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

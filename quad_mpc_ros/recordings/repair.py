"""Completing a recording that was cut short: index, ``metadata.yaml``."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, Header, McapRecord, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC, Writer

from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.recordings import bag_metadata
from quad_mpc_ros.recordings.mcap_file import McapFile
from quad_mpc_ros.recordings.mcap_output import LIBRARY, sync_directory
from quad_mpc_ros.recordings.qos_profile import QosProfile, parse_qos_profiles
from quad_mpc_ros.recordings.reader import (
    BagReader,
    mcap_files_in,
    recorded_information,
    topics_in,
)
from quad_mpc_ros.recordings.salvage import Salvage

_BROKEN = ".broken"
_TEMPORARY = ".repairing"


@dataclass(frozen=True, kw_only=True)
class RepairedFile:
    """What became of one damaged file."""

    path: Path
    original: Path
    message_count: int
    damaged_chunks: int
    unreadable_bytes: int
    """What is left after the last whole record: the beginning of the one that was cut."""


@dataclass(frozen=True, kw_only=True)
class Repair:
    """What a repair did; ``metadata.yaml`` is new if it was ``needed`` at all."""

    files: Sequence[RepairedFile]
    needed: bool


def repair(path: Path) -> Repair:
    """Make a complete bag of what a killed recorder or a power failure left at ``path``.

    Each MCAP file that has no end, or a wrong checksum, is written anew from its whole records;
    the original stays beside it as ``<name>.broken``. ``metadata.yaml`` is written when a file
    was, when it is missing, or when it does not list the files that are there; an old one
    stays as ``metadata.yaml.broken``. A complete bag is left alone. A repair that is interrupted
    leaves the originals and can be repeated.

    Raises :class:`BagError` for what is no bag, and when the disk refuses; nothing of the
    recording is ever overwritten.

    The folder of a run has its bag in ``bag/``. A single MCAP file is repaired alike, without
    ``metadata.yaml``; one of a bag only with it.
    """
    if path.is_file():
        return _repaired_alone(path)
    if not path.is_dir():
        raise BagError(f"{path}: is no bag directory and no .mcap file")
    return _repaired_bag(bag_metadata.bag_of(path))


def _repaired_alone(path: Path) -> Repair:
    """Repair one file that is in no bag."""
    if (path.parent / bag_metadata.METADATA_FILE).exists():
        raise BagError(f"{path}: is a part of a bag: quad_mpc bag repair {path.parent}")
    _refuse_packed([path])
    if _is_whole(path):
        return Repair(files=(), needed=False)
    try:
        return Repair(files=[_repaired(path)], needed=True)
    except OSError as error:
        raise BagError(f"{path}: cannot be repaired: {os_reason(error)}") from error


def _repaired_bag(directory: Path) -> Repair:
    _undo_interrupted_repair(directory)
    paths = mcap_files_in(directory)
    damaged = [path for path in paths if not _is_whole(path)]
    if not damaged and _is_complete(directory, paths):
        return Repair(files=(), needed=False)
    _refuse_packed(paths)
    try:
        repaired = [_repaired(path) for path in damaged]
        _write_metadata(directory, paths)
    except OSError as error:
        raise BagError(f"{directory}: cannot be repaired: {os_reason(error)}") from error
    return Repair(files=repaired, needed=True)


def _refuse_packed(paths: Sequence[Path]) -> None:
    packed = [path for path in paths if path.suffix == ".zstd"]
    if packed:
        raise BagError(f"{packed[0]}: is compressed as a whole; unpack it first: unzstd FILE")


def _undo_interrupted_repair(directory: Path) -> None:
    """Give an original its name back, where a repair was stopped between two renamings."""
    for original in directory.glob(f"*.mcap{_BROKEN}"):
        path = original.with_name(original.name.removesuffix(_BROKEN))
        if not path.exists():
            original.rename(path)


def _is_complete(directory: Path, paths: Sequence[Path]) -> bool:
    try:
        reader = BagReader(directory)
    except BagError:
        return False
    return reader.complete and sorted(reader.files) == sorted(paths)


def _is_whole(path: Path) -> bool:
    try:
        file = McapFile(path)
        if file.finished:
            file.verify()
    except BagError:
        return False
    return file.finished


def _repaired(path: Path) -> RepairedFile:
    original = _place_for_original(path)
    temporary = path.with_name(f"{path.name}{_TEMPORARY}")
    copy = _Copy()
    try:
        with path.open("rb") as damaged, temporary.open("wb") as stream:
            _check_beginning(path, damaged.read(len(MCAP0_MAGIC)))
            size = os.fstat(damaged.fileno()).st_size
            salvage = Salvage(damaged)
            copy.write(salvage, Writer(stream, enable_data_crcs=True))
            stream.flush()
            os.fsync(stream.fileno())
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _put_in_place(temporary, path, original=original)
    return RepairedFile(
        path=path,
        original=original,
        message_count=copy.message_count,
        damaged_chunks=salvage.damaged_chunks,
        unreadable_bytes=max(0, size - salvage.read_up_to),
    )


def _place_for_original(path: Path) -> Path:
    original = path.with_name(f"{path.name}{_BROKEN}")
    if original.exists() and not original.samefile(path):
        raise BagError(f"{original} exists already, from an earlier repair; move it away")
    return original


def _check_beginning(path: Path, start: bytes) -> None:
    """Refuse what is no MCAP file; one may be cut, or filled with zeros, from its start."""
    if not MCAP0_MAGIC.startswith(start.rstrip(b"\0")):
        raise BagError(f"{path}: is not an MCAP file")


def _put_in_place(temporary: Path, path: Path, *, original: Path) -> None:
    """Move the repaired file to ``path``; the old one becomes ``original`` first."""
    if not original.exists():
        try:
            original.hardlink_to(path)
        except OSError:  # a file system without links
            path.rename(original)
    temporary.replace(path)
    sync_directory(path.parent)


class _Copy:
    """Writes records of one file into another, which may number its channels differently."""

    def __init__(self) -> None:
        self.message_count = 0
        self._schema_ids = {0: 0}  # no schema
        self._channel_ids: dict[int, int] = {}

    def write(self, salvage: Salvage, writer: Writer) -> None:
        records = salvage.records()
        first = next(records, None)
        profile = first.profile if isinstance(first, Header) else "ros2"
        writer.start(profile=profile, library=LIBRARY)
        for record in itertools.chain((first,), records):
            self._write_record(record, writer)
        writer.finish()  # type: ignore[no-untyped-call]

    def _write_record(self, record: McapRecord | None, writer: Writer) -> None:
        if isinstance(record, Schema) and record.id not in self._schema_ids:
            self._schema_ids[record.id] = writer.register_schema(
                name=record.name, encoding=record.encoding, data=record.data
            )
        elif isinstance(record, Channel) and record.id not in self._channel_ids:
            self._channel_ids[record.id] = writer.register_channel(
                topic=record.topic,
                message_encoding=record.message_encoding,
                schema_id=self._schema_ids.get(record.schema_id, 0),
                metadata=record.metadata,
            )
        elif isinstance(record, Message) and record.channel_id in self._channel_ids:
            self.message_count += 1
            writer.add_message(
                channel_id=self._channel_ids[record.channel_id],
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


def _write_metadata(directory: Path, paths: Sequence[Path]) -> None:
    files = [McapFile(path) for path in paths]
    information = bag_metadata.bag_information(
        files=[
            bag_metadata.FileSummary(
                name=file.path.name,
                span=file.contents.span,
                message_count=sum(file.contents.message_counts.values()),
            )
            for file in files
        ],
        topics=[
            bag_metadata.TopicSummary(
                name=name,
                type_name=topic.type_name,
                type_hash=topic.type_hash,
                qos_profiles=_profiles(topic.qos_profiles),
                message_count=topic.message_count,
            )
            for name, topic in topics_in(files).items()
        ],
        **_message_compression(files),
    )
    path = directory / bag_metadata.METADATA_FILE
    if path.exists():
        path.rename(_place_for_original(path))
    write_atomically(path, bag_metadata.dump_yaml({bag_metadata.METADATA_ROOT: information}))
    sync_directory(directory)


def _message_compression(files: Sequence[McapFile]) -> dict[str, str]:
    """Return rosbag2's own compression, as recorded in the files themselves."""
    for file in files:
        information = recorded_information(file.contents.metadata)
        if str(information.get("compression_mode")).upper() == "MESSAGE":
            keys = ("compression_format", "compression_mode")
            return {key: str(information.get(key)) for key in keys}
    return {}


def _profiles(text: str) -> tuple[QosProfile, ...]:
    try:
        return parse_qos_profiles(text)
    except BagError:  # of another writer; keep the messages
        return ()

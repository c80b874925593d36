"""Completing a recording that was cut short: index, ``metadata.yaml``."""

from __future__ import annotations

import contextlib
import os
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Message
from mcap.writer import MCAP0_MAGIC, Writer

from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.recordings import bag_metadata
from quad_mpc_ros.recordings.mcap_file import McapFile
from quad_mpc_ros.recordings.mcap_records import WholeRecords, copy_records
from quad_mpc_ros.recordings.qos_profile import QosProfile, parse_qos_profiles
from quad_mpc_ros.recordings.reader import (
    LATEST_NS,
    LONGEST_BAG_NS,
    BagReader,
    mcap_files_in,
    recorded_information,
    topics_in,
)
from quad_mpc_ros.recordings.writer import sync_directory

_BROKEN_SUFFIX = ".broken"
_TEMPORARY_SUFFIX = ".repairing"


@dataclass(frozen=True, kw_only=True)
class RepairedFile:
    """What became of one damaged file."""

    path: Path
    original: Path
    message_count: int
    damaged_chunks: int
    corrected_times: int
    """Messages whose log time was decades before or after those of the others."""
    unreadable_bytes: int
    """What is left after the last whole record: the beginning of the one that was cut."""


@dataclass(frozen=True, kw_only=True)
class Repair:
    """What a repair did; ``metadata.yaml`` is new if it was ``needed`` at all."""

    files: Sequence[RepairedFile]
    needed: bool


def repair(path: Path) -> Repair:
    """Make a complete bag of what a killed recorder or a power failure left at ``path``.

    Each MCAP file that has no end, a wrong checksum, no index of its messages or wrong log times
    is written again from its whole records; the original stays beside it as ``<name>.broken``. A
    log time that is decades from the others becomes the publish time, or if that is wrong as well,
    the log time of the message before. ``metadata.yaml`` is written when a file was, when it is
    missing or unusable, or when it does not list the files that are there; an old one
    stays as ``metadata.yaml.broken``. A sound bag is left alone. A repair that is interrupted
    leaves the originals and can be repeated.

    Raises :class:`BagError` for what is no bag, and when the disk refuses; nothing of the
    recording is ever overwritten.

    The folder of a run has its bag in ``bag/``. A single MCAP file is repaired alike, without
    ``metadata.yaml``; one of a bag only with it.
    """
    directory = None
    if path.is_dir():
        directory = bag_metadata.bag_of(path)
        _undo_interrupted_repair(directory)
        paths = mcap_files_in(directory)
    elif not path.is_file():
        raise BagError(f"{path}: is no bag directory and no .mcap file")
    elif (path.parent / bag_metadata.METADATA_FILE).exists():
        raise BagError(f"{path}: is a part of a bag: quad_mpc bag repair {path.parent}")
    else:
        paths = [path]
    damaged = [each for each in paths if not _is_whole(each)]
    if _have_wrong_log_times(paths):
        damaged = paths
    if not damaged and (directory is None or _is_complete(directory, paths)):
        return Repair(files=(), needed=False)
    _refuse_packed(paths)
    try:
        times = _LogTimes(paths if damaged else ())
        repaired = [_repaired(each, times) for each in damaged]
        if directory is not None:
            _write_metadata(directory, paths)
    except OSError as error:
        raise BagError(f"{path}: cannot be repaired: {os_reason(error)}") from error
    return Repair(files=repaired, needed=True)


def _refuse_packed(paths: Sequence[Path]) -> None:
    packed = [path for path in paths if path.suffix == ".zstd"]
    if packed:
        raise BagError(f"{packed[0]}: is compressed as a whole; unpack it first: unzstd FILE")


def _undo_interrupted_repair(directory: Path) -> None:
    """Give an original its name back, where a repair was stopped between two renamings."""
    for original in directory.glob(f"*.mcap{_BROKEN_SUFFIX}"):
        path = original.with_name(original.name.removesuffix(_BROKEN_SUFFIX))
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


def _have_wrong_log_times(paths: Sequence[Path]) -> bool:
    """Return whether the readable ones of some files span more than a bag can."""
    spans = []
    for path in paths:
        with contextlib.suppress(BagError):
            spans.append(McapFile(path).contents.span)
    span = bag_metadata.united(spans)
    return span is not None and span.duration_ns > LONGEST_BAG_NS


class _LogTimes:
    """Corrects log times that are too far from the median of all messages of some files."""

    def __init__(self, paths: Sequence[Path]) -> None:
        times = array("Q")
        for path in paths:
            with path.open("rb") as stream:
                records = WholeRecords(stream)
                times.extend(each.log_time for each in records if isinstance(each, Message))
        median = sorted(times)[len(times) // 2] if times else 0
        end = min(median + LONGEST_BAG_NS, LATEST_NS + 1)
        self._possible = range(max(0, median - LONGEST_BAG_NS), max(end, 1))
        self._first = min((each for each in times if each in self._possible), default=0)
        self.begin_file()

    def begin_file(self) -> None:
        """Restart the counts before the first message of a file."""
        self.corrected_count = 0
        self._last = self._first

    def corrected(self, message: Message) -> Message:
        """Return a message with the log time that it had, or what is nearest that makes sense."""
        times = (message.log_time, message.publish_time, self._last)
        self._last = next(each for each in times if each in self._possible)
        is_wrong = self._last != message.log_time
        self.corrected_count += is_wrong
        if (is_wrong or message.publish_time > LATEST_NS) and (
            message.publish_time not in self._possible
        ):
            message.publish_time = self._last
        message.log_time = self._last
        return message


def _repaired(path: Path, times: _LogTimes) -> RepairedFile:
    original = _place_for_original(path)
    temporary = path.with_name(f"{path.name}{_TEMPORARY_SUFFIX}")
    times.begin_file()
    try:
        with path.open("rb") as damaged, temporary.open("wb") as stream:
            _check_beginning(path, damaged.read(len(MCAP0_MAGIC)))
            size = os.fstat(damaged.fileno()).st_size
            records = WholeRecords(damaged)
            writer = Writer(stream, enable_data_crcs=True)
            message_count = copy_records(records, writer, corrected=times.corrected)
            stream.flush()
            os.fsync(stream.fileno())
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _put_in_place(temporary, path, original=original)
    return RepairedFile(
        path=path,
        original=original,
        message_count=message_count,
        damaged_chunks=records.damaged_chunks,
        corrected_times=times.corrected_count,
        unreadable_bytes=max(0, size - records.read_up_to),
    )


def _place_for_original(path: Path) -> Path:
    original = path.with_name(f"{path.name}{_BROKEN_SUFFIX}")
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

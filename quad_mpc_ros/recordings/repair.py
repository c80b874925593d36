"""Repair of an interrupted recording: index, ``metadata.yaml``."""

from __future__ import annotations

import contextlib
import os
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.records import McapRecord, Message
from mcap.writer import MCAP0_MAGIC, Writer

from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.recordings.bag_metadata import bag_of, sync_directory, write_metadata
from quad_mpc_ros.recordings.mcap_file import (
    LATEST_NS,
    LONGEST_BAG_NS,
    MAGIC_SIZE,
    METADATA_FILE,
    McapFile,
    OtherFormatError,
    repair_command,
    united_span,
)
from quad_mpc_ros.recordings.mcap_records import WholeRecords, copy_records
from quad_mpc_ros.recordings.reader import BagReader, mcap_files_in

_BROKEN_SUFFIX = ".broken"
_TEMPORARY_SUFFIX = ".repairing"


@dataclass(frozen=True, kw_only=True)
class RepairedFile:
    """The repair of one damaged file."""

    path: Path
    original: Path
    message_count: int
    damaged_chunks: int
    """Omitted chunks with a wrong checksum or content."""


@dataclass(frozen=True, kw_only=True)
class Repair:
    """The result of a repair; ``metadata.yaml`` is new if a repair was ``needed``."""

    files: Sequence[RepairedFile]
    needed: bool


def repair(path: Path) -> Repair:
    """Complete a bag that was left by a killed recorder or a power failure at ``path``.

    Each MCAP file without end, with a wrong checksum, without message index or with wrong log
    times is rewritten from its complete records; the original is kept as ``<name>.broken``. A log
    time that is decades off becomes the publish time or, if this is also wrong, the log time of
    the previous message. ``metadata.yaml`` is written if a file was rewritten, or if it is
    missing, unusable or does not list the existing files; the old file is kept as
    ``metadata.yaml.broken``. An intact bag is not changed. An interrupted repair keeps the
    originals and can be repeated.

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
    if _have_wrong_log_times(paths):
        damaged = paths
    if not damaged and (directory is None or _is_complete(directory, paths)):
        return Repair(files=(), needed=False)
    try:
        possible_times = _possible_times(paths) if damaged else range(0)
        repaired = [_repaired(each, possible_times) for each in damaged]
        if directory is not None:
            _replace_metadata(directory, paths)
    except OSError as error:
        raise BagError(f"{path}: cannot be repaired: {os_reason(error)}") from error
    return Repair(files=repaired, needed=True)


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


def _have_wrong_log_times(paths: Sequence[Path]) -> bool:
    """Return whether the readable files span more time than a bag can."""
    readable = []
    for path in paths:
        with contextlib.suppress(BagError):
            readable.append(McapFile(path))
    span = united_span(readable)
    return span is not None and span.duration_ns > LONGEST_BAG_NS


def _possible_times(paths: Sequence[Path]) -> range:
    """Return the log times [ns] that are near enough to the median of all messages of files.

    The first record is a message.
    """
    times = array("Q")
    for path in paths:
        with path.open("rb") as stream:
            records = WholeRecords(stream)
            times.extend(each.log_time for each in records if isinstance(each, Message))
    median = sorted(times)[len(times) // 2] if times else 0
    earliest, latest = median - LONGEST_BAG_NS, min(median + LONGEST_BAG_NS, LATEST_NS)
    first = min((each for each in times if earliest <= each <= latest), default=0)
    return range(first, latest + 1)


def _with_possible_times(records: WholeRecords, possible: range) -> Iterator[McapRecord]:
    """Yield records; impossible log times are replaced by plausible log times."""
    last = possible.start
    for record in records:
        if isinstance(record, Message):
            times = (record.log_time, record.publish_time)
            last = next((each for each in times if each in possible), last)
            is_wrong = last != record.log_time or record.publish_time > LATEST_NS
            if is_wrong and record.publish_time not in possible:
                record.publish_time = last
            record.log_time = last
        yield record


def _repaired(path: Path, possible_times: range) -> RepairedFile:
    original = _place_for_original(path)
    temporary = path.with_name(f"{path.name}{_TEMPORARY_SUFFIX}")
    try:
        with path.open("rb") as damaged, temporary.open("wb") as stream:
            _check_beginning(path, damaged.read(MAGIC_SIZE))
            records = WholeRecords(damaged)
            writer = Writer(stream, enable_data_crcs=True)
            message_count = copy_records(_with_possible_times(records, possible_times), writer)
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


def _check_beginning(path: Path, start: bytes) -> None:
    """Reject other files than MCAP; an MCAP file may be truncated, or zeros, from its start."""
    if not MCAP0_MAGIC.startswith(start.rstrip(b"\0")):
        raise BagError(f"{path}: is not an MCAP file")


def _replace_metadata(directory: Path, paths: Sequence[Path]) -> None:
    """Write ``metadata.yaml``; keep the old file under another name."""
    path = directory / METADATA_FILE
    if path.exists():
        path.rename(_place_for_original(path))
    write_metadata(directory, [McapFile(each) for each in paths])
    sync_directory(directory)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading a bag: a rosbag2 directory of MCAP files, or a single MCAP file."""

from __future__ import annotations

import heapq
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from quad_mpc_ros.configuration import ros_yaml
from quad_mpc_ros.configuration.errors import BagError, UserError, text_of
from quad_mpc_ros.messages.schemas import MSG_ENCODING
from quad_mpc_ros.recordings.bag_metadata import METADATA_ROOT, bag_of
from quad_mpc_ros.recordings.mcap_file import (
    CONVERT,
    LATEST_NS,
    METADATA_FILE,
    McapFile,
    OtherFormatError,
    TimeSpan,
    TopicInfo,
    repair_command,
    topics_in,
    unfinished,
    united_span,
)

if TYPE_CHECKING:
    from quad_mpc_ros.messages.codec import MessageDecoder


CDR = "cdr"
"""The encoding of messages in ROS 2."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedMessage:
    """One message of a bag; times in nanoseconds since the epoch of the recorder's clock."""

    topic: str
    type_name: str
    log_time_ns: int
    publish_time_ns: int
    data: bytes
    _decode: Callable[[str, bytes], Any] = field(repr=False)

    @cached_property
    def message(self) -> Any:
        """Return the decoded message; raises as :meth:`.MessageDecoder.decode`."""
        return self._decode(self.type_name, self.data)


class BagReader:
    """A recorded bag.

    No file stays open between calls. Every failure is a :class:`BagError` of one line that names
    the file and the reason.
    """

    def __init__(self, path: Path) -> None:
        """Open a bag directory, one ``.mcap`` file, or the folder of a run with ``bag/`` in it.

        Raises :class:`BagError` for an interrupted recording, which must be repaired first.
        """
        self.path = path = bag_of(path)
        if not path.exists():
            raise BagError(f"{path}: does not exist")
        paths = [path] if path.is_file() else _listed_files(path)
        self._files = [McapFile(file) for file in paths]

    @cached_property
    def topics(self) -> Mapping[str, TopicInfo]:
        """Return every topic of the bag by name, including topics without messages."""
        return topics_in(self._files)

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the MCAP metadata records by name, the last record of duplicate names."""
        return {
            record.name: dict(record.metadata) for file in self._files for record in file.metadata
        }

    @property
    def files(self) -> Sequence[Path]:
        """Return the paths of the bag's MCAP files."""
        return [file.path for file in self._files]

    @property
    def span(self) -> TimeSpan | None:
        """Return the log times of the first message and the last; None without messages."""
        return united_span(self._files)

    @cached_property
    def _decoder(self) -> MessageDecoder:
        from quad_mpc_ros.messages.codec import MessageDecoder  # slow; replaying decodes nothing

        return MessageDecoder(
            {
                schema.name: schema.data.decode(errors="replace")
                for file in self._files
                for schema in file.summary.schemas.values()
                if schema.encoding == MSG_ENCODING
            }
        )

    def require_cdr(self, topics: Iterable[str]) -> None:
        """Raise :class:`BagError` for a topic with messages not encoded in CDR."""
        for topic in topics:
            encoding = self.topics[topic].encoding
            if encoding != CDR:
                raise BagError(f"{self.path}: topic {topic}: {encoding_error(encoding)}")

    def messages(
        self, topics: Collection[str] | None = None, *, from_ns: int = 0
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of ``topics`` (all by default) from a log time on, in log-time order.

        Messages with equal times are in the recorded order. A topic that is not in the bag has no
        messages. Raises :class:`BagError` for times that rosbag2 cannot store.
        """
        streams = [file.messages(topics, from_ns=from_ns) for file in self._files]
        for schema, channel, message in heapq.merge(*streams, key=lambda item: item[2].log_time):
            if max(message.log_time, message.publish_time) > LATEST_NS:
                raise BagError(
                    f"{self.path}: a message on {channel.topic} is logged at "
                    f"{message.log_time} ns and published at {message.publish_time} ns, "
                    "expected times up to 2262"
                )
            yield RecordedMessage(
                topic=channel.topic,
                type_name=schema.name if schema else "",
                log_time_ns=message.log_time,
                publish_time_ns=message.publish_time,
                data=message.data,
                _decode=lambda *message: self._decoder.decode(*message),
            )


def encoding_error(encoding: str) -> str:
    """Return the error about messages in an encoding other than CDR, with a remedy."""
    hint = "; record them with a ROS 2 recorder"
    if encoding == "ros1":
        hint = f"; convert the ROS 1 bag: {CONVERT.format('FILE.bag', 'DIR')}"
    return f"its messages are encoded as {text_of(encoding)}, expected {CDR!r} (ROS 2){hint}"


def mcap_files_in(directory: Path) -> list[Path]:
    """Return the MCAP files in a directory by their number.

    Raises :class:`BagError` if there is no file.
    """
    files = sorted(directory.glob("*.mcap"), key=_number_and_name)
    if not files:
        others = sorted((*directory.glob("*.db3"), *directory.glob("*.bag")))
        if others:
            raise OtherFormatError(directory, "holds a bag of another format", *others)
        raise BagError(f"{directory}: not a bag: neither {METADATA_FILE} nor an .mcap file in it")
    return files


def _number_and_name(path: Path) -> tuple[int, str]:
    match = re.search(r"_(\d+)\.mcap", path.name)
    return (int(match[1]) if match else -1, path.name)


def _listed_files(directory: Path) -> list[Path]:
    """Return the files that ``metadata.yaml`` lists."""
    metadata_path = directory / METADATA_FILE
    if not metadata_path.exists():
        mcap_files_in(directory)  # raises if there is none
        raise unfinished(directory)
    information = _bag_information(metadata_path)
    storage = information.get("storage_identifier")
    names = information.get("relative_file_paths")
    if not storage:
        raise _unusable(metadata_path, "storage_identifier is empty, expected 'mcap'")
    if storage != "mcap":
        raise OtherFormatError(metadata_path, f"storage is {text_of(storage)}", directory)
    mode = str(information.get("compression_mode") or "NONE").upper()
    if mode != "NONE":
        raise OtherFormatError(metadata_path, f"rosbag2's compression is {mode}", directory)
    if not isinstance(names, list) or not names:
        raise _unusable(metadata_path, "relative_file_paths is empty")
    # Before its version 4 rosbag2 wrote the name of the bag in front.
    files = [directory / PurePath(str(name)).name for name in names]
    there = {file.name for file in directory.iterdir()}
    missing = [file.name for file in files if file.name not in there]
    if missing:
        raise _unusable(metadata_path, f"lists {missing[0]}, which does not exist")
    return files


def _bag_information(metadata_path: Path) -> Mapping[str, Any]:
    try:
        content = ros_yaml.read_file(metadata_path)
    except UserError as error:
        raise BagError(f"{error}; rewrite it: {repair_command(metadata_path)}") from error
    information = content.get(METADATA_ROOT) if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise _unusable(metadata_path, f"{METADATA_ROOT} is missing")
    return information


def _unusable(metadata_path: Path, why: str) -> BagError:
    return BagError(f"{metadata_path}: {why}; rewrite it: {repair_command(metadata_path)}")

"""Reading a bag: a rosbag2 directory, finished or not, or a single MCAP file."""

from __future__ import annotations

import heapq
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import yaml
from mcap.records import Metadata

from quad_mpc_ros.configuration import ros_yaml
from quad_mpc_ros.configuration.errors import BagError, UserError, text_of
from quad_mpc_ros.messages.schemas import MSG_ENCODING
from quad_mpc_ros.recordings.bag_metadata import (
    METADATA_FILE,
    METADATA_ROOT,
    TimeSpan,
    bag_of,
    united,
)
from quad_mpc_ros.recordings.mcap_file import CONVERT, McapFile, conversion

if TYPE_CHECKING:
    from quad_mpc_ros.messages.codec import MessageDecoder


CDR = "cdr"
"""The encoding of messages in ROS 2."""
LATEST_NS = 2**63 - 1
LONGEST_BAG_NS = 10 * 365 * 86400 * 10**9


@dataclass(frozen=True, kw_only=True)
class TopicInfo:
    """One topic of a bag.

    ``encoding`` is that of its messages, ``cdr`` in ROS 2. ``qos_profiles`` is YAML, one entry a
    publisher, as rosbag2 wrote it; it and ``type_hash`` are empty when the bag lacks them.
    """

    type_name: str
    encoding: str
    message_count: int
    qos_profiles: str
    type_hash: str


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

        A directory is read by its ``metadata.yaml``; without one, because the recording was cut
        short, it is every ``.mcap`` file in it, by number. What rosbag2 compressed with zstd, by
        file or by message, is unpacked.
        """
        self.path = path = bag_of(path)
        information = _bag_information(path / METADATA_FILE)
        paths = _mcap_files(path) if information is None else _listed_files(path, information)
        self._files = [McapFile(file) for file in paths]
        self._complete = information is not None or path.is_file()
        if information is None:
            information = recorded_information(self._files[0].contents.metadata)
        self._unpack = _message_unpacker(information)

    @cached_property
    def topics(self) -> Mapping[str, TopicInfo]:
        """Return every topic of the bag by name, those without messages included."""
        return topics_in(self._files)

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the MCAP metadata records by name; of several of a name, the last."""
        return {
            record.name: dict(record.metadata)
            for file in self._files
            for record in file.contents.metadata
        }

    @property
    def files(self) -> Sequence[Path]:
        """Return the paths of the bag's MCAP files."""
        return [file.path for file in self._files]

    @property
    def complete(self) -> bool:
        """Whether the bag has its ``metadata.yaml`` and every file its end."""
        return self._complete and all(file.finished for file in self._files)

    @property
    def warning(self) -> str:
        """What is wrong with the bag and how to repair it; empty of a sound one."""
        if not self.complete:
            return (
                f"{self.path} is unfinished: it is read as far as it is whole; to complete it: "
                f"quad_mpc bag repair {self.path}"
            )
        if self.has_wrong_log_times:
            return (
                f"{self.path}: messages are logged decades before or after the others; to correct "
                f"their log times: quad_mpc bag repair {self.path}"
            )
        return ""

    @property
    def has_wrong_log_times(self) -> bool:
        """Whether some messages were logged by a clock that was not set.

        A recorder on simulated time logs at 0 what comes before the first ``/clock``.
        """
        return self.span is not None and self.duration_ns > LONGEST_BAG_NS

    @property
    def span(self) -> TimeSpan | None:
        """Return the log times of the first message and the last; None without messages."""
        return united(file.contents.span for file in self._files)

    @property
    def duration_ns(self) -> int:
        """Return the time from the first message to the last [ns]; 0 without messages."""
        return self.span.duration_ns if self.span else 0

    @cached_property
    def _decoder(self) -> MessageDecoder:
        from quad_mpc_ros.messages.codec import MessageDecoder  # copying needs no rosbags

        return MessageDecoder(
            {
                schema.name: schema.data.decode(errors="replace")
                for file in self._files
                for schema in file.contents.schemas.values()
                if schema.encoding == MSG_ENCODING
            }
        )

    def _decode(self, type_name: str, data: bytes) -> Any:
        return self._decoder.decode(type_name, data)

    def require_cdr(self, topics: Iterable[str]) -> None:
        """Raise :class:`BagError` for a topic whose messages are not encoded as ROS 2 does."""
        for topic in topics:
            encoding = self.topics[topic].encoding
            if encoding != CDR:
                raise BagError(f"{self.path}: topic {topic}: {encoding_error(encoding)}")

    def messages(
        self, topics: Collection[str] | None = None, *, from_ns: int = 0
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of ``topics`` (all by default) from a log time on, in its order.

        Messages of the same time come in the order in which they were recorded. A topic that is
        not in the bag has no messages.
        """
        streams = [file.messages(topics, from_ns=from_ns) for file in self._files]
        for schema, channel, message in heapq.merge(*streams, key=lambda item: item[2].log_time):
            if max(message.log_time, message.publish_time) > LATEST_NS:
                raise BagError(
                    f"{self.path}: a message on {channel.topic} is logged at "
                    f"{message.log_time} ns and published at {message.publish_time} ns, "
                    f"expected times up to 2262: quad_mpc bag repair {self.path}"
                )
            yield RecordedMessage(
                topic=channel.topic,
                type_name=schema.name if schema else "",
                log_time_ns=message.log_time,
                publish_time_ns=message.publish_time,
                data=self._unpack(channel.topic, message.data),
                _decode=self._decode,
            )


def encoding_error(encoding: str) -> str:
    """Return what is wrong with messages in another encoding than CDR, and what to do."""
    hint = "; record them with a ROS 2 recorder"
    if encoding == "ros1":
        hint = f"; convert the ROS 1 bag: {CONVERT.format('FILE.bag', 'DIR')}"
    return f"its messages are encoded as {text_of(encoding)}, expected {CDR!r} (ROS 2){hint}"


def topics_in(files: Iterable[McapFile]) -> dict[str, TopicInfo]:
    """Return every topic of some files by name, those without messages included."""
    found: dict[str, TopicInfo] = {}
    for contents in (file.contents for file in files):
        for channel_id, channel in contents.channels.items():
            schema = contents.schemas.get(channel.schema_id)
            count = contents.message_counts[channel_id]
            known = found.get(channel.topic)
            found[channel.topic] = TopicInfo(
                type_name=schema.name if schema else "",
                encoding=channel.message_encoding,
                message_count=count + (known.message_count if known else 0),
                qos_profiles=channel.metadata.get("offered_qos_profiles", ""),
                type_hash=channel.metadata.get("topic_type_hash", ""),
            )
    return found


def recorded_information(records: Iterable[Metadata]) -> Mapping[str, Any]:
    """Return the copy of ``metadata.yaml`` in the metadata records of an MCAP file.

    Empty when there is none.
    """
    texts = [r.metadata.get("serialized_metadata", "") for r in records if r.name == "rosbag2"]
    try:
        information = ros_yaml.read(texts[-1]) if texts else None
    except yaml.YAMLError:
        return {}
    return information if isinstance(information, dict) else {}


def mcap_files_in(directory: Path) -> list[Path]:
    """Return the MCAP files in a directory by their number.

    Raises :class:`BagError` when there is none.
    """
    files = sorted(
        (file for pattern in _FILE_PATTERNS for file in directory.glob(pattern)),
        key=_number_and_name,
    )
    if not files:
        others = sorted((*directory.glob("*.db3"), *directory.glob("*.bag")))
        reason = f"is no bag: neither {METADATA_FILE} nor an .mcap file in it"
        if others:
            reason = conversion("holds a bag of another format", *others)
        raise BagError(f"{directory}: {reason}")
    return files


_FILE_NUMBER = re.compile(r"_(\d+)\.mcap")
_FILE_PATTERNS = ("*.mcap", "*.mcap.zstd")
_COMPRESSION_MODES = ("FILE", "MESSAGE")


def _mcap_files(path: Path) -> list[Path]:
    if not path.exists():
        raise BagError(f"{path}: does not exist")
    if path.is_file():
        return [path]
    return mcap_files_in(path)


def _number_and_name(path: Path) -> tuple[int, str]:
    match = _FILE_NUMBER.search(path.name)
    return (int(match[1]) if match else -1, path.name)


def _listed_files(directory: Path, information: Mapping[str, Any]) -> list[Path]:
    metadata_path = directory / METADATA_FILE
    storage = information.get("storage_identifier")
    names = information.get("relative_file_paths")
    if not storage:
        raise _unusable(metadata_path, "storage_identifier is empty, expected 'mcap'")
    if storage != "mcap":
        reason = conversion(f"storage is {text_of(storage)}", directory)
        raise BagError(f"{metadata_path}: {reason}")
    mode, method = information.get("compression_mode"), information.get("compression_format")
    if mode and (str(mode).upper() not in _COMPRESSION_MODES or method != "zstd"):
        raise BagError(
            f"{metadata_path}: compression {text_of(method)} of mode {text_of(mode)} is not "
            "supported, expected zstd of FILE or MESSAGE; convert the bag with `ros2 bag convert`"
        )
    if not isinstance(names, list) or not names:
        raise _unusable(metadata_path, "relative_file_paths names no file")
    # Before its version 4 rosbag2 wrote the name of the bag in front.
    files = [directory / PurePath(str(name)).name for name in names]
    there = {file.name for file in directory.iterdir()}
    missing = [file.name for file in files if file.name not in there]
    if missing:
        raise _unusable(metadata_path, f"lists {missing[0]}, which is not there")
    return files


def _message_unpacker(information: Mapping[str, Any]) -> Callable[[str, bytes], bytes]:
    """Return a function of a topic and the bytes of a message, which rosbag2 may compress."""
    if str(information.get("compression_mode")).upper() != "MESSAGE":
        return lambda _, data: data
    import zstandard

    decompressor = zstandard.ZstdDecompressor()

    def unpack(topic: str, data: bytes) -> bytes:
        try:
            return decompressor.decompress(data)
        except zstandard.ZstdError as error:
            raise BagError(f"{topic}: message is corrupt: {error}") from error

    return unpack


def _bag_information(metadata_path: Path) -> Mapping[str, Any] | None:
    if not metadata_path.exists():
        return None
    try:
        content = ros_yaml.read_file(metadata_path)
    except UserError as error:
        raise BagError(f"{error}; {_repair(metadata_path)}") from error
    information = content.get(METADATA_ROOT) if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise _unusable(metadata_path, f"{METADATA_ROOT} is missing")
    return information


def _unusable(metadata_path: Path, why: str) -> BagError:
    return BagError(f"{metadata_path}: {why}; {_repair(metadata_path)}")


def _repair(metadata_path: Path) -> str:
    return f"write it again: quad_mpc bag repair {metadata_path.parent}"

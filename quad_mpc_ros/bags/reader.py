"""Reading a bag: a rosbag2 directory, finished or not, or a single MCAP file."""

from __future__ import annotations

import heapq
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from quad_mpc_ros.bags.bag_metadata import METADATA_FILE, METADATA_ROOT
from quad_mpc_ros.bags.codec import RosbagsMessages
from quad_mpc_ros.bags.errors import BagError, os_reason
from quad_mpc_ros.bags.mcap_file import McapFile, McapMessage
from quad_mpc_ros.bags.schemas import MessageSchema


@dataclass(frozen=True, kw_only=True)
class TopicInfo:
    """What a bag tells of one topic.

    ``qos_profiles`` is YAML, one entry a publisher, as rosbag2 wrote it; it and ``type_hash``
    are empty when the bag does not tell.
    """

    type_name: str
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
    _decoder: _Decoder = field(repr=False)

    @cached_property
    def message(self) -> Any:
        """Return the decoded message, see :meth:`RosbagsMessages.decode`.

        Raises :class:`BagError` for data that do not fit the type, and for a type whose
        definition in the bag is unusable or differs from the one in ROS 2 Jazzy.
        """
        return self._decoder.decode(self.type_name, self.data)


class BagReader:
    """A recorded bag.

    No file stays open between calls. Every failure is a :class:`BagError` of one line that names
    the file and the reason.
    """

    def __init__(self, path: Path) -> None:
        """Open a bag directory, or one ``.mcap`` file.

        A directory is read by its ``metadata.yaml``; without one, because the recording was cut
        short, it is every ``.mcap`` file in it, by number.
        """
        self._path = path
        self._files = [McapFile(file) for file in _mcap_files(path)]
        self._decoder = _Decoder(self._files)

    @cached_property
    def topics(self) -> Mapping[str, TopicInfo]:
        """Return every topic of the bag by name, those without messages included."""
        found: dict[str, TopicInfo] = {}
        for file in self._files:
            contents = file.contents
            for channel_id, channel in contents.channels.items():
                schema = contents.schemas.get(channel.schema_id)
                count = contents.message_counts[channel_id]
                known = found.get(channel.topic)
                found[channel.topic] = TopicInfo(
                    type_name=schema.name if schema else "",
                    message_count=count + (known.message_count if known else 0),
                    qos_profiles=channel.metadata.get("offered_qos_profiles", ""),
                    type_hash=channel.metadata.get("topic_type_hash", ""),
                )
        return found

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the MCAP metadata records by name; of several of a name, the last."""
        return {
            record.name: dict(record.metadata)
            for file in self._files
            for record in file.contents.metadata
        }

    @property
    def duration_ns(self) -> int:
        """Return the time from the first message to the last [ns]; 0 without messages."""
        spans = [file.contents.span for file in self._files if file.contents.span]
        if not spans:
            return 0
        return max(span.end_ns for span in spans) - min(span.start_ns for span in spans)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
        """Yield the messages of ``topics`` (all by default) in log-time order.

        Messages of the same time come in the order in which they were recorded. A topic that is
        not in the bag has no messages.
        """
        streams = [file.messages(topics) for file in self._files]
        for item in heapq.merge(*streams, key=_log_time_ns):
            yield RecordedMessage(
                topic=item.channel.topic,
                type_name=item.schema.name if item.schema else "",
                log_time_ns=item.message.log_time,
                publish_time_ns=item.message.publish_time,
                data=item.message.data,
                _decoder=self._decoder,
            )


class _Decoder:
    """Decodes by the definitions in the bag, each looked at when its first message is."""

    def __init__(self, files: list[McapFile]) -> None:
        self._codec: RosbagsMessages | None = None
        self._unregistered = {
            schema.name: schema.data
            for file in files
            for schema in file.contents.schemas.values()
            if schema.encoding == "ros2msg"
        }

    def decode(self, type_name: str, data: bytes) -> Any:
        if self._codec is None:
            self._codec = RosbagsMessages()
        text = self._unregistered.get(type_name)
        if text is not None:
            schema = MessageSchema(
                type_name=type_name, text=text.decode(errors="replace"), type_hash=""
            )
            self._codec.register(schema)
            del self._unregistered[type_name]
        return self._codec.decode(type_name, data)


_FILE_NUMBER = re.compile(r"_(\d+)$")


def _log_time_ns(item: McapMessage) -> int:
    return item.message.log_time


def _mcap_files(path: Path) -> list[Path]:
    if not path.exists():
        raise BagError(f"{path}: does not exist")
    if path.is_file():
        return [path]
    if (path / METADATA_FILE).exists():
        return _listed_files(path)
    files = sorted(path.glob("*.mcap"), key=_number_and_name)
    if not files:
        raise BagError(f"{path}: is no bag: neither {METADATA_FILE} nor an .mcap file in it")
    return files


def _number_and_name(path: Path) -> tuple[int, str]:
    match = _FILE_NUMBER.search(path.stem)
    return (int(match[1]) if match else -1, path.name)


def _listed_files(directory: Path) -> list[Path]:
    metadata_path = directory / METADATA_FILE
    information = _bag_information(metadata_path)
    storage = information.get("storage_identifier")
    if storage != "mcap":
        raise BagError(
            f"{metadata_path}: storage is {storage!r}, expected 'mcap'; convert the bag with "
            "`ros2 bag convert`"
        )
    if information.get("compression_mode"):
        raise BagError(
            f"{metadata_path}: compression mode {information['compression_mode']!r} is not "
            "supported, only MCAP's own; convert the bag with `ros2 bag convert`"
        )
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names:
        raise BagError(f"{metadata_path}: relative_file_paths names no file")
    return [directory / str(name) for name in names]


def _bag_information(metadata_path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(metadata_path.read_bytes())
    except OSError as error:
        raise BagError(f"{metadata_path}: cannot be read: {os_reason(error)}") from error
    except (yaml.YAMLError, ValueError) as error:
        first_line = str(error).partition("\n")[0]
        raise BagError(f"{metadata_path}: is not YAML: {first_line}") from error
    information = content.get(METADATA_ROOT) if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise BagError(f"{metadata_path}: {METADATA_ROOT} is missing")
    return information

"""Reading a bag: a rosbag2 directory, finished or not, or a single MCAP file."""

from __future__ import annotations

import heapq
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from mcap.records import Metadata

from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.messages.schemas import IDL_ENCODING, MSG_ENCODING, MessageSchema
from quad_mpc_ros.recordings.bag_metadata import (
    METADATA_FILE,
    METADATA_ROOT,
    TimeSpan,
    bag_of,
    united,
)
from quad_mpc_ros.recordings.mcap_file import McapFile, McapMessage

if TYPE_CHECKING:
    from quad_mpc_ros.messages.codec import MessageDecoder


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
    _decoder: _Decoder = field(repr=False)

    @cached_property
    def message(self) -> Any:
        """Return the decoded message, see :meth:`MessageDecoder.decode`.

        Raises :class:`BagError` for data that do not fit the type, and for a definition in the
        bag that is unusable or differs from the one in ROS 2 Jazzy.
        """
        return self._decoder.decode(self.type_name, self.data)


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
        self._decoder = _Decoder(self._files)
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
    def unfinished(self) -> str:
        """What to say of a bag that was not ended properly; empty of a complete one."""
        if self.complete:
            return ""
        return (
            f"{self.path} is unfinished: it is read as far as it is whole; to complete it: "
            f"quad_mpc bag repair {self.path}"
        )

    @property
    def span(self) -> TimeSpan | None:
        """Return the log times of the first message and the last; None without messages."""
        return united(file.contents.span for file in self._files)

    @property
    def duration_ns(self) -> int:
        """Return the time from the first message to the last [ns]; 0 without messages."""
        return self.span.duration_ns if self.span else 0

    def messages(
        self, topics: Collection[str] | None = None, *, from_ns: int = 0
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of ``topics`` (all by default) from a log time on, in its order.

        Messages of the same time come in the order in which they were recorded. A topic that is
        not in the bag has no messages.
        """
        streams = [file.messages(topics, from_ns=from_ns) for file in self._files]
        for item in heapq.merge(*streams, key=lambda item: item.message.log_time):
            yield RecordedMessage(
                topic=item.channel.topic,
                type_name=item.schema.name if item.schema else "",
                log_time_ns=item.message.log_time,
                publish_time_ns=item.message.publish_time,
                data=self._unpack(item),
                _decoder=self._decoder,
            )


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
        information = yaml.safe_load(texts[-1]) if texts else None
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
        raise BagError(f"{directory}: is no bag: neither {METADATA_FILE} nor an .mcap file in it")
    return files


class _Decoder:
    """Decodes by the definitions in the bag, each parsed with its first message."""

    def __init__(self, files: list[McapFile]) -> None:
        self._codec: MessageDecoder | None = None
        self._unregistered = {
            schema.name: schema
            for file in files
            for schema in file.contents.schemas.values()
            if schema.encoding in (MSG_ENCODING, IDL_ENCODING)
        }

    def decode(self, type_name: str, data: bytes) -> Any:
        if self._codec is None:
            from quad_mpc_ros.messages.codec import MessageDecoder  # copying needs no rosbags

            self._codec = MessageDecoder()
        schema = self._unregistered.get(type_name)
        if schema is not None:
            self._codec.register(
                MessageSchema(
                    type_name=type_name,
                    text=schema.data.decode(errors="replace"),
                    type_hash="",
                    encoding=schema.encoding,
                )
            )
            del self._unregistered[type_name]
        return self._codec.decode(type_name, data)


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
    if storage != "mcap":
        raise BagError(
            f"{metadata_path}: storage is {storage!r}, expected 'mcap'; convert the bag with "
            "`ros2 bag convert`"
        )
    mode, method = information.get("compression_mode"), information.get("compression_format")
    if mode and (str(mode).upper() not in _COMPRESSION_MODES or method != "zstd"):
        raise BagError(
            f"{metadata_path}: compression {method!r} of mode {mode!r} is not supported, expected "
            "zstd of FILE or MESSAGE; convert the bag with `ros2 bag convert`"
        )
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names:
        raise BagError(f"{metadata_path}: relative_file_paths names no file")
    return [directory / str(name) for name in names]


def _message_unpacker(information: Mapping[str, Any]) -> Callable[[McapMessage], bytes]:
    """Return what makes the message of an MCAP message, which rosbag2 may have compressed."""
    if str(information.get("compression_mode")).upper() != "MESSAGE":
        return lambda item: item.message.data
    import zstandard

    decompressor = zstandard.ZstdDecompressor()

    def unpack(item: McapMessage) -> bytes:
        try:
            return decompressor.decompress(item.message.data)
        except zstandard.ZstdError as error:
            raise BagError(f"{item.channel.topic}: message is corrupt: {error}") from error

    return unpack


def _bag_information(metadata_path: Path) -> Mapping[str, Any] | None:
    try:
        content = yaml.safe_load(metadata_path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise BagError(f"{metadata_path}: cannot be read: {os_reason(error)}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        first_line = str(error).partition("\n")[0]
        raise BagError(f"{metadata_path}: is not YAML: {first_line}") from error
    information = content.get(METADATA_ROOT) if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise BagError(f"{metadata_path}: {METADATA_ROOT} is missing")
    return information

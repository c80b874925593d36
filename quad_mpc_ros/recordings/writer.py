# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Writing a bag: a rosbag2 directory with one MCAP file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal, Self

from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos

from quad_mpc_ros.configuration.errors import BagError, os_reason
from quad_mpc_ros.messages.schemas import MSG_ENCODING, schema_for
from quad_mpc_ros.recordings.bag_metadata import bag_information, sync_directory, write_metadata
from quad_mpc_ros.recordings.mcap_file import LATEST_NS, LIBRARY, McapFile
from quad_mpc_ros.recordings.qos import qos_text

Compression = Literal["none", "zstd", "lz4"]

FLUSH_PERIOD_S = 0.5
"""Time between two flushes of :meth:`BagWriter.flush_if_due` [s]."""


class BagWriter:
    """A bag being written: ``<directory>/<directory name>_0.mcap`` and ``metadata.yaml``.

    Messages are collected in a chunk; :meth:`flush_if_due` and :meth:`close` end the chunk and
    pass it to the operating system. Passed chunks survive the death of this process, even by
    SIGKILL, and can be read without the end of the file. With ``durable`` they also survive a
    power failure: every flush waits for the storage device. ``metadata.yaml`` is written last and
    atomically: a bag with this file is complete.

    Not thread-safe. Every failure is a :class:`BagError`; after a disk error the writer is
    closed and the bag ends at the last whole chunk.
    """

    def __init__(
        self,
        directory: Path,
        *,
        compression: Compression = "zstd",
        durable: bool = False,
    ) -> None:
        """Create ``directory`` with its parents and start a recording there.

        Raises :class:`BagError`, without changes, if the path exists or cannot be created.
        """
        self.directory = directory
        self._file = directory / f"{directory.name}_0.mcap"
        self._durable = durable
        self._closed_because = ""
        self._schema_ids: dict[str, int] = {}
        self._channel_ids: dict[str, int] = {}
        self._unflushed = True
        self._flushed_at_s = float("-inf")
        try:
            directory.mkdir(parents=True)
            self._stream = self._file.open("xb")
        except FileExistsError as error:
            raise BagExistsError(directory) from error
        except OSError as error:
            raise BagError(
                f"{directory} cannot be created: {os_reason(error)}; choose a directory that you "
                "may write to"
            ) from error
        self._mcap = Writer(
            self._stream, compression=CompressionType[compression.upper()], enable_data_crcs=True
        )
        with self._disk():
            self._mcap.start(profile="ros2", library=LIBRARY)
            self._mcap.add_metadata("rosbag2", {"serialized_metadata": bag_information()})
        self.flush()
        if durable:
            sync_directory(directory)
            sync_directory(directory.absolute().parent)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add_topic(self, topic: str, type_name: str, *, qos_profiles: Sequence[Qos] = ()) -> None:
        """Announce ``topic`` (the full name) with the QoS of each of its publishers.

        Raises :class:`BagError` for a type without schema, and for a disk error.
        """
        schema = schema_for(type_name)
        with self._disk():
            if type_name not in self._schema_ids:
                self._schema_ids[type_name] = self._mcap.register_schema(
                    name=type_name, encoding=MSG_ENCODING, data=schema.text.encode()
                )
            self._channel_ids[topic] = self._mcap.register_channel(
                topic=topic,
                message_encoding="cdr",
                schema_id=self._schema_ids[type_name],
                metadata={
                    "offered_qos_profiles": qos_text(qos_profiles),
                    "topic_type_hash": schema.type_hash,
                },
            )

    def write(self, topic: str, data: bytes, *, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one serialized message; times are nanoseconds since the epoch of the clock.

        Raises :class:`BagError` for a topic that was not added, a time that rosbag2 cannot store
        (negative, or 2^63 and more), and a disk error.
        """
        if topic not in self._channel_ids:
            raise BagError(f"{self._file}: topic {topic} was not added before the first message")
        if not (0 <= log_time_ns <= LATEST_NS and 0 <= publish_time_ns <= LATEST_NS):
            raise BagError(
                f"{self._file}: {topic}: time {log_time_ns} or {publish_time_ns} ns is outside "
                f"0 to {LATEST_NS}"
            )
        with self._disk():
            self._mcap.add_message(
                channel_id=self._channel_ids[topic],
                log_time=log_time_ns,
                data=data,
                publish_time=publish_time_ns,
            )
        self._unflushed = True

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append an MCAP Metadata record; the last of duplicate names is used."""
        with self._disk():
            self._mcap.add_metadata(name, dict(values))
        self._unflushed = True

    def flush_if_due(self, monotonic_now_s: float) -> None:
        """Pass collected messages to the operating system if the last flush is long ago.

        Call this several times a second, even without messages, with the time of a monotonic clock
        [s], so that only the last second is lost if the process dies. Flushing ends the chunk, and
        small chunks compress badly: hence not at every call.
        """
        if self._unflushed and monotonic_now_s - self._flushed_at_s >= FLUSH_PERIOD_S:
            self.flush()
            self._flushed_at_s = monotonic_now_s

    def flush(self) -> None:
        """End the chunk and pass it to the operating system, or to the device."""
        if self._unflushed:
            with self._disk():
                self._mcap.flush()  # type: ignore[no-untyped-call]
                if self._durable:
                    os.fdatasync(self._stream.fileno())
            self._unflushed = False

    def close(self) -> None:
        """Complete the bag: index, ``metadata.yaml``. A closed bag is unchanged."""
        if self._closed_because:
            return
        with self._disk():
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()
            if self._durable:
                os.fsync(self._stream.fileno())
            self._stream.close()
            write_metadata(self.directory, [McapFile(self._file)])
            if self._durable:
                sync_directory(self.directory)
        self._closed_because = "closed"

    @contextmanager
    def _disk(self) -> Iterator[None]:
        if self._closed_because:
            raise BagError(f"{self._file}: cannot write: the bag is {self._closed_because}")
        try:
            yield
        except OSError as error:
            self._closed_because = f"closed after a disk error ({os_reason(error)})"
            with suppress(OSError):  # the buffer that could not be written is still full
                self._stream.close()
            raise BagError(
                f"{self._file}: cannot write: {os_reason(error)}; the bag ends here, "
                "free space or record elsewhere"
            ) from error


class BagExistsError(BagError):
    """The directory of a new bag already exists."""

    def __init__(self, directory: Path) -> None:
        super().__init__(f"{directory} exists already; choose another name or move it")

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A recording in progress: its bag, topics and parameters of nodes."""

from __future__ import annotations

import datetime
import itertools
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rclpy.node import Node
from rclpy.qos import QoSProfile

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.topics import OPTIONAL, RECORDED
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.recordings.parameters import write_parameters
from quad_mpc_ros.recordings.writer import BagExistsError, BagWriter
from quad_mpc_ros.ros.messages import message_class, qos_of
from quad_mpc_ros.ros.nodes.bag_qos import recorded_profile, strictest_common_profile
from quad_mpc_ros.ros.nodes.parameter_query import ParameterQuery
from quad_mpc_ros.ros.nodes.topic_recorder import TopicRecorder

Write = Callable[[int], None]
"""Writes a message with a time of reception [ns]."""


class Recorder:
    """One bag, created by the first :meth:`resume` and ended by :meth:`close`.

    While paused it has no subscriptions, so a latched message of that time is recorded after the
    pause. ``on_fault`` is called with the reason if the bag cannot be written.
    """

    def __init__(
        self, node: Node, config: RecorderConfig, *, on_fault: Callable[[str], None]
    ) -> None:
        """Initialise. Raises :class:`BagError` if the folder of the bag already exists."""
        if config.directory and Path(config.directory).exists():
            raise BagExistsError(Path(config.directory))
        self._node = node
        self._config = config
        self._on_fault = on_fault
        self._topics = [node.resolve_topic_name(name) for name in config.topics]
        self._writer: BagWriter | None = None
        self._type_names: dict[str, str] = {}
        self._recorded: dict[str, TopicRecorder] = {}
        self._expected: dict[str, TopicRecorder] = {}  # without a publisher yet
        self._refused: set[str] = set()
        self._early: list[Write] = []
        self._ordered = PublishedOrder()
        self._parameter_queries = {name: ParameterQuery(node, name) for name in config.nodes}
        self._parameter_queries.pop(node.get_name(), None)
        self.message_count = 0
        self.newest_ns = 0
        """When the last message was published [ns]."""
        self._lost_before = 0  # before the last pause
        self.fault: str | None = None

    @property
    def missing(self) -> list[str]:
        """The required topics without a publisher."""
        optional = {self._node.resolve_topic_name(each.name) for each in OPTIONAL}
        return [
            topic
            for topic in self._topics
            if topic not in self._recorded and topic not in optional
        ]

    @property
    def unanswered(self) -> list[str]:
        """The nodes whose parameters have not arrived."""
        return [name for name, query in self._parameter_queries.items() if not query.done]

    @property
    def publisher_counts(self) -> dict[str, int]:
        """The number of matched publishers by topic."""
        return {topic: recording.publisher_count for topic, recording in self._recorded.items()}

    @property
    def lost_count(self) -> int:
        """Number of messages lost in transit."""
        lost = sum(recording.lost_count for recording in self._recorded.values())
        return self._lost_before + lost

    def resume(self) -> Path:
        """Start or continue recording; return the folder of the bag.

        Raises :class:`BagError` if the bag cannot be created.
        """
        if self._writer is None:
            self._writer = new_bag(self._config)
            write_parameters(self._writer, self._node.get_name(), self._config.flattened())
        self._subscribe_early()
        self.poll()
        return self._writer.directory

    def pause(self) -> None:
        """Destroy the subscriptions and flush received messages to the operating system."""
        for recording in (*self._recorded.values(), *self._expected.values()):
            recording.close()
        self._lost_before = self.lost_count
        self._recorded.clear()
        self._expected.clear()
        self._refused.clear()
        self._ordered.write_all()
        self._guarded(lambda writer: writer.flush())

    def close(self) -> None:
        """End the bag, if it was started."""
        self.pause()
        for query in self._parameter_queries.values():
            query.close()
        self._write_early(0)
        self._guarded(lambda writer: writer.close())

    def poll(self) -> bool:
        """Flush if due, subscribe to further topics, query parameters.

        Call this several times a second while recording. Returns whether topics or parameters were
        added.
        """
        self._ordered.write_older()
        self._guarded(lambda writer: writer.flush_if_due(time.monotonic()))
        more = False
        for topic in sorted({*self._topics} - self._recorded.keys() - self._refused):
            more |= self._subscribe(topic)
        for recording in self._recorded.values():
            recording.follow_publishers(time.monotonic())
        for query in self._parameter_queries.values():
            more |= self._take_parameters(query)
        return more

    def _subscribe_early(self) -> None:
        """Subscribe to topics of known types before they have a publisher.

        A publisher matches an existing subscription in milliseconds, a later subscription after
        0.1 s or even seconds.
        """
        for topic in RECORDED:
            name = self._node.resolve_topic_name(topic.name)
            if name in self._topics:
                self._expected[name] = self._recorder_of(
                    name, topic.type_name, strictest_common_profile([qos_of(topic)])
                )

    def _recorder_of(self, topic: str, type_name: str, profile: QoSProfile) -> TopicRecorder:
        return TopicRecorder(
            self._node,
            topic=topic,
            type_name=type_name,
            profile=profile,
            receive=partial(self._on_message, topic),
        )

    def _subscribe(self, topic: str) -> bool:
        publishers = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return False
        type_names = sorted({info.topic_type for info in publishers})
        profiles = [info.qos_profile for info in publishers]
        try:
            if len(type_names) > 1:
                raise BagError("its publishers have different types")
            message_class(type_names[0])  # raises if it is not installed
            self._announce(topic, type_names[0], profiles)
        except (ImportError, AttributeError, ValueError, BagError) as error:
            self._refused.add(topic)
            if topic in self._expected:
                self._expected.pop(topic).close()
            self._node.get_logger().error(
                f"cannot record {topic} of type {', '.join(type_names)}: {error}"
            )
            return False
        expected = self._expected.pop(topic, None)
        if expected is not None and expected.type_name != type_names[0]:
            expected.close()
            expected = None
        self._recorded[topic] = expected or self._recorder_of(
            topic, type_names[0], strictest_common_profile(profiles)
        )
        return True

    def _announce(self, topic: str, type_name: str, profiles: list[QoSProfile]) -> None:
        """Add a topic to the bag, unless it was added before a pause."""
        before = self._type_names.get(topic)
        if before is None and self._writer is not None:
            self._writer.add_topic(
                topic, type_name, qos_profiles=[recorded_profile(profile) for profile in profiles]
            )
            self._type_names[topic] = type_name
        elif before != type_name:
            raise BagError(f"the topic is recorded as {before}")

    def _on_message(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        if topic in self._expected and not self._subscribe(topic):
            return  # its publisher has already ended
        write = partial(self._write, topic, data, info["source_timestamp"])
        self.message_count += 1
        self.newest_ns = info["source_timestamp"]
        clock = self._node.get_clock()
        if not clock.ros_time_is_active:
            write(info["received_timestamp"])
            return
        now_ns = int(clock.now().nanoseconds)
        if now_ns == 0:  # simulated time has not started
            self._early.append(write)
            return
        self._write_early(now_ns)
        self._ordered.add(info["source_timestamp"], now_ns, write)

    def _write(self, topic: str, data: bytes, publish_time_ns: int, log_time_ns: int) -> None:
        self._guarded(
            lambda writer: writer.write(
                topic, data, log_time_ns=log_time_ns, publish_time_ns=publish_time_ns
            )
        )

    def _write_early(self, now_ns: int) -> None:
        """Write messages received before simulated time started, with its first time."""
        for write in self._early:
            write(now_ns)
        self._early.clear()

    def _take_parameters(self, query: ParameterQuery) -> bool:
        values = query.poll()
        if values is None:
            return False
        self._guarded(lambda writer: write_parameters(writer, query.node_name, values))
        return True

    def _guarded(self, action: Callable[[BagWriter], None]) -> None:
        """Access the bag; after a failure nothing more is written."""
        if self._writer is None or self.fault is not None:
            return
        try:
            action(self._writer)
        except BagError as error:
            self.fault = str(error)
            self._on_fault(self.fault)


class PublishedOrder:
    """Holds messages briefly and writes them in the order of their publication.

    The times of reception are assigned in the same order. In simulated time an executor may
    deliver an odometry before the reference that the flight waited for. Playing such a bag in
    lockstep would never end.
    """

    def __init__(self) -> None:
        self._held: list[tuple[int, int, Write]] = []  # time of publication, of reception
        self._due_ns = 0  # newest publication at the last call of write_older
        self._newest_ns = 0  # time of reception of written messages

    def add(self, published_ns: int, received_ns: int, write: Write) -> None:
        """Add a message: its time of publication (system clock), and of reception (recording)."""
        self._held.append((published_ns, received_ns, write))

    def write_older(self) -> None:
        """Write the messages published before those added since the last call.

        Call this periodically: messages late by more than a period stay out of order.
        """
        due = [each for each in self._held if each[0] <= self._due_ns]
        self._held = [each for each in self._held if each[0] > self._due_ns]
        self._due_ns = max((each[0] for each in self._held), default=0)
        self._write(due)

    def write_all(self) -> None:
        """Write all held messages."""
        held, self._held = self._held, []
        self._write(held)

    def _write(self, messages: list[tuple[int, int, Write]]) -> None:
        received = sorted(received_ns for _, received_ns, _ in messages)
        ordered = sorted(messages, key=lambda each: each[0])
        for (_, _, write), received_ns in zip(ordered, received, strict=True):
            self._newest_ns = max(received_ns, self._newest_ns)
            write(self._newest_ns)


def new_bag(config: RecorderConfig) -> BagWriter:
    """Create a bag in the configured folder, or in a new folder with a unique name."""
    name = config.directory or datetime.datetime.now().strftime("rosbag2_%Y_%m_%d-%H_%M_%S")
    names = itertools.chain([name], (f"{name}_{number}" for number in itertools.count(1)))
    while True:
        try:
            return BagWriter(
                Path(next(names)),
                compression=config.compression,  # type: ignore[arg-type]
                durable=config.sync,
            )
        except BagExistsError:
            if config.directory:
                raise  # else another recorder started in the same second

"""The recorder node: topics into a rosbag2 directory, as raw serialized messages."""

from __future__ import annotations

import datetime
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from quad_mpc_ros.bags import BagError, BagWriter, Split
from quad_mpc_ros.bags.config import RecorderConfig
from quad_mpc_ros.bags.run_parameters import write_parameters
from quad_mpc_ros.bags.topic_selection import TopicSelection
from quad_mpc_ros.nodes.parameter_query import ParameterQuery
from quad_mpc_ros.nodes.recorded_qos import offered
from quad_mpc_ros.nodes.topic_recording import TopicRecording
from quad_mpc_ros.ros.health import ERROR, OK, PEERS_KEY, WARN, Health, HealthReporter
from quad_mpc_ros.ros.messages import message_class
from quad_mpc_ros.ros.parameters import declare
from quad_mpc_ros.ros.spin import run, stop

_PERIOD = 0.1


class RecorderNode(Node):
    """Subscribes to what is asked for as it appears on the graph, and writes what comes."""

    def __init__(self) -> None:
        super().__init__("recorder", automatically_declare_parameters_from_overrides=True)
        self.exit_code = 0
        config = declare(self, RecorderConfig)
        self._selection = TopicSelection(
            names=tuple(self.resolve_topic_name(name) for name in config.topics),
            pattern=config.topics_regex,
            exclude=config.topics_exclude_regex,
            everything=config.all,
        )
        self._writer = BagWriter(
            _directory(config),
            compression=config.compression,  # type: ignore[arg-type]
            split=Split(
                max_size=config.max_bag_size,
                max_duration_ns=round(config.max_bag_duration * 1e9),
            ),
            durable=config.sync,
        )
        self._recorded: dict[str, TopicRecording] = {}
        self._refused: set[str] = set()
        self._early: list[Callable[[int], None]] = []
        self._messages = 0
        self._fault: str | None = None

        write_parameters(self._writer, self.get_name(), config.flattened())
        self._asked = {name: ParameterQuery(self, name) for name in config.nodes}
        self._asked.pop(self.get_name(), None)

        self._health = HealthReporter(self, self._probe)
        # One timer for both: what wakes the node costs more than what it does then.
        self.create_timer(_PERIOD, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"recording to {self._writer.directory}")

    def destroy_node(self) -> None:
        """End the bag, then the node."""
        self._write_early(0)
        self._guarded(self._writer.close)
        super().destroy_node()

    def _on_timer(self) -> None:
        self._guarded(lambda: self._writer.flush_if_due(time.monotonic()))
        self._discover()

    def _discover(self) -> None:
        """Subscribe to wanted topics that have a publisher by now, and ask for parameters."""
        changed = False
        for topic in self._appeared():
            changed |= self._subscribe(topic)
        for recording in self._recorded.values():
            recording.follow_publishers(time.monotonic())
        for query in self._asked.values():
            changed |= self._take_parameters(query)
        if changed:
            self._health.report()

    def _appeared(self) -> list[str]:
        known = self._recorded.keys() | self._refused
        if self._selection.by_name_only:
            candidates = set(self._selection.names) - known
        else:
            candidates = {name for name, _ in self.get_topic_names_and_types()} - known
        return sorted(topic for topic in candidates if self._selection.includes(topic))

    def _subscribe(self, topic: str) -> bool:
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return False
        type_names = sorted({info.topic_type for info in publishers})
        profiles = [info.qos_profile for info in publishers]
        try:
            if len(type_names) > 1:
                raise BagError("its publishers do not agree on the type")
            message_type = message_class(type_names[0])
            self._writer.add_topic(
                topic, type_names[0], qos_profiles=[offered(profile) for profile in profiles]
            )
        except (ImportError, AttributeError, ValueError, BagError) as error:
            self._refused.add(topic)
            self.get_logger().error(
                f"cannot record {topic} of type {', '.join(type_names)}: {error}"
            )
            return False
        self._recorded[topic] = TopicRecording(
            self,
            topic=topic,
            type_name=type_names[0],
            message_type=message_type,
            publishers=profiles,
            receive=partial(self._on_message, topic),
        )
        return True

    def _on_message(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        write = partial(self._write, topic, data, info["source_timestamp"])
        self._messages += 1
        if not self.get_clock().ros_time_is_active:
            write(info["received_timestamp"])
            return
        now_ns = int(self.get_clock().now().nanoseconds)
        if now_ns == 0:  # simulated time that has not begun
            self._early.append(write)
            return
        self._write_early(now_ns)
        write(now_ns)

    def _write(self, topic: str, data: bytes, publish_time_ns: int, log_time_ns: int) -> None:
        self._guarded(
            lambda: self._writer.write(
                topic, data, log_time_ns=log_time_ns, publish_time_ns=publish_time_ns
            )
        )

    def _write_early(self, now_ns: int) -> None:
        """Write what came before simulated time began, as if it came when it did."""
        for write in self._early:
            write(now_ns)
        self._early.clear()

    def _take_parameters(self, query: ParameterQuery) -> bool:
        values = query.poll()
        if values is None:
            return False
        self._guarded(lambda: write_parameters(self._writer, query.node_name, values))
        return True

    def _guarded(self, action: Callable[[], None]) -> None:
        """Do something with the bag; when the disk refuses, end the recording and say why."""
        if self._fault is not None:
            return
        try:
            action()
        except BagError as error:
            self._fault, self.exit_code = str(error), 1
            self.get_logger().fatal(f"recording ended: {error}")
            stop()

    def _probe(self) -> Health:
        missing = [topic for topic in self._selection.names if topic not in self._recorded]
        text = self._fault or (f"not there yet: {', '.join(missing)}" if missing else "recording")
        unasked = [name for name, query in self._asked.items() if not query.done]
        return Health(
            level=ERROR if self._fault else WARN if missing else OK,
            text=text,
            values=[
                *(
                    (f"{PEERS_KEY}{topic}", str(recording.publisher_count))
                    for topic, recording in self._recorded.items()
                ),
                ("messages", str(self._messages)),
                ("parameters_missing", " ".join(unasked)),
            ],
        )


def _directory(config: RecorderConfig) -> Path:
    if config.directory:
        return Path(config.directory)
    return Path(datetime.datetime.now().strftime("rosbag2_%Y_%m_%d-%H_%M_%S"))


def main(args: list[str] | None = None) -> None:
    """Run the node: ``ros2 run quad_mpc_ros recorder_node``."""
    sys.exit(run(RecorderNode, args, message_info=True))


if __name__ == "__main__":
    main()

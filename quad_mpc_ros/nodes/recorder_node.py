"""The recorder node: topics into a rosbag2 directory, as raw serialized messages."""

from __future__ import annotations

import datetime
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from quad_mpc_ros.bags import BagError, BagWriter, QosProfile
from quad_mpc_ros.bags.config import RecorderConfig
from quad_mpc_ros.bags.run_parameters import write_parameters
from quad_mpc_ros.ros.health import ERROR, OK, PEERS_KEY, WARN, Health, HealthReporter
from quad_mpc_ros.ros.messages import message_class
from quad_mpc_ros.ros.parameters import declare
from quad_mpc_ros.ros.spin import run, stop

_DISCOVERY_PERIOD = 0.1
_FLUSH_PERIOD = 0.25
_QUEUE_DEPTH = 1000  # room for a stall of several seconds


class RecorderNode(Node):
    """Subscribes to what is asked for as it appears on the graph, and writes what comes."""

    def __init__(self) -> None:
        super().__init__("recorder", automatically_declare_parameters_from_overrides=True)
        self.exit_code = 0
        config = declare(self, RecorderConfig)
        self._writer = BagWriter(
            _directory(config),
            compression=config.compression,  # type: ignore[arg-type]
        )
        self._wanted = [self.resolve_topic_name(name) for name in config.topics]
        self._recorded: dict[str, Subscription] = {}
        self._unknown: set[str] = set()
        self._messages = 0
        self._fault: str | None = None

        write_parameters(self._writer, self.get_name(), config.flattened())
        self._asked = {name: _ParameterQuery(self, name) for name in config.nodes}
        self._asked.pop(self.get_name(), None)

        self._health = HealthReporter(self, self._probe)
        self._every(_DISCOVERY_PERIOD, self._discover)
        self._every(_FLUSH_PERIOD, self._flush)
        self.get_logger().info(f"recording to {self._writer.directory}")

    def destroy_node(self) -> None:
        """End the bag, then the node."""
        self._guarded(self._writer.close)
        super().destroy_node()

    def _discover(self) -> None:
        """Subscribe to wanted topics that have a publisher by now, and ask for parameters."""
        changed = False
        for topic in self._wanted:
            if topic not in self._recorded and topic not in self._unknown:
                changed |= self._subscribe(topic)
        for query in self._asked.values():
            changed |= self._take_parameters(query)
        if changed:
            self._health.report()

    def _subscribe(self, topic: str) -> bool:
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return False
        type_name = publishers[0].topic_type
        try:
            message_type = message_class(type_name)
            self._writer.add_topic(
                topic, type_name, qos_profiles=[_offered(info.qos_profile) for info in publishers]
            )
        except (ImportError, AttributeError, BagError) as error:
            self._unknown.add(topic)
            self.get_logger().error(f"cannot record {topic} of type {type_name}: {error}")
            return False
        self._recorded[topic] = self.create_subscription(
            message_type,
            topic,
            self._writing(topic),
            _adapted([info.qos_profile for info in publishers]),
            raw=True,
        )
        return True

    def _writing(self, topic: str) -> Callable[[bytes, dict[str, int]], None]:
        def write(data: bytes, info: dict[str, int]) -> None:
            now_ns = int(self.get_clock().now().nanoseconds)
            self._guarded(
                lambda: self._writer.write(
                    topic, data, log_time_ns=now_ns, publish_time_ns=info["source_timestamp"]
                )
            )
            self._messages += 1

        return write

    def _take_parameters(self, query: _ParameterQuery) -> bool:
        values = query.poll()
        if values is None:
            return False
        self._guarded(lambda: write_parameters(self._writer, query.node_name, values))
        return True

    def _flush(self) -> None:
        self._guarded(lambda: self._writer.flush_if_due(time.monotonic()))

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

    def _every(self, period: float, callback: Callable[[], None]) -> None:
        self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _probe(self) -> Health:
        missing = [topic for topic in self._wanted if topic not in self._recorded]
        text = self._fault or (f"not there yet: {', '.join(missing)}" if missing else "recording")
        unasked = [name for name, query in self._asked.items() if not query.done]
        return Health(
            level=ERROR if self._fault else WARN if missing else OK,
            text=text,
            values=[
                *(
                    (f"{PEERS_KEY}{topic}", str(subscription.get_publisher_count()))
                    for topic, subscription in self._recorded.items()
                ),
                ("messages", str(self._messages)),
                ("parameters_missing", " ".join(unasked)),
            ],
        )


class _ParameterQuery:
    """Asks another node for all its parameters, without waiting for it."""

    def __init__(self, node: Node, node_name: str) -> None:
        self.node_name = node_name
        self.done = False
        self._client = AsyncParameterClient(node, node_name)
        self._names: Any = None
        self._values: Any = None

    def poll(self) -> dict[str, Any] | None:
        """Take the next step; return the parameters, once, when they have come."""
        if self.done or not self._client.services_are_ready():
            return None
        if self._names is None:
            self._names = self._client.list_parameters()
        elif self._names.done() and self._values is None:
            self._values = self._client.get_parameters(self._names.result().result.names)
        elif self._values is not None and self._values.done():
            self.done = True
            return self._received()
        return None

    def _received(self) -> dict[str, Any]:
        names = self._names.result().result.names
        values = (parameter_value_to_python(value) for value in self._values.result().values)
        return {
            name: value if isinstance(value, bool | int | float | str) else list(value)
            for name, value in zip(names, values, strict=True)
            if value is not None
        }


def _directory(config: RecorderConfig) -> Path:
    if config.directory:
        return Path(config.directory)
    return Path(datetime.datetime.now().strftime("rosbag2_%Y_%m_%d-%H_%M_%S"))


def _adapted(offered: list[QoSProfile]) -> QoSProfile:
    """Return the strictest profile that every publisher of a topic can serve, as rosbag2 does."""
    reliable = all(q.reliability == ReliabilityPolicy.RELIABLE for q in offered)
    latched = all(q.durability == DurabilityPolicy.TRANSIENT_LOCAL for q in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=_QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _offered(profile: QoSProfile) -> QosProfile:
    """Return rclpy's profile as the bag writes it down."""
    return QosProfile(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline=profile.deadline.nanoseconds,
        lifespan=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_duration=profile.liveliness_lease_duration.nanoseconds,
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def main(args: list[str] | None = None) -> None:
    """Run the node: ``ros2 run quad_mpc_ros recorder_node``."""
    sys.exit(run(RecorderNode, args, message_info=True))


if __name__ == "__main__":
    main()

"""Receiving one topic from all its publishers, whatever quality of service each of them offers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from quad_mpc_ros.ros.messages import message_class
from quad_mpc_ros.ros.nodes.bag_qos import adapted

_HANDOVER_S = 1.0  # in which a new subscription and the publishers find each other

Receiver = Callable[[bytes, dict[str, int]], None]
"""Takes a serialized message and rclpy's information on it."""


class TopicRecorder:
    """A subscription that asks for the most that every publisher serves.

    When a publisher joins that offers less, a subscription that asks for less takes over. For a
    while both receive, so that nothing is lost, and what comes twice is passed on once.

    Publishers number their messages. Where numbers are missing messages were lost on their way:
    who is starved of the processor for so long that the system's buffers run over loses some.
    They are counted while there is one publisher; whose message it is is not told.
    """

    def __init__(
        self,
        node: Node,
        *,
        topic: str,
        type_name: str,
        publishers: Sequence[QoSProfile],
        receive: Receiver,
    ) -> None:
        self._node = node
        self._topic = topic
        self._type_name = type_name
        self._receive = receive
        self._leaving: Subscription | None = None
        self._leaves_at_s = 0.0
        self._seen: set[tuple[int, bytes]] = set()
        self._told: set[str] = set()
        self._closed = False
        self._newest: int | None = None
        self.lost_count = 0
        """How many messages were lost on their way."""
        self._profile = adapted(publishers)
        self._subscription = self._subscribe()

    @property
    def publisher_count(self) -> int:
        """Return the number of publishers that are heard."""
        return int(self._subscription.get_publisher_count())

    def close(self) -> None:
        """Hear no more, not even what the executor already holds."""
        self._closed = True
        for subscription in (self._subscription, self._leaving):
            if subscription is not None:
                self._node.destroy_subscription(subscription)
        self._leaving = None

    def follow_publishers(self, now_s: float) -> None:
        """Adapt to the publishers there are; ``now_s`` is of a monotonic clock [s]."""
        if self._leaving is not None:
            if now_s < self._leaves_at_s:
                return
            self._node.destroy_subscription(self._leaving)
            self._leaving = None
            self._seen.clear()
        if self._node.count_publishers(self._topic) > self.publisher_count:
            self._ask_for_less(now_s)

    def _ask_for_less(self, now_s: float) -> None:
        profiles = [self._profile]
        for info in self._node.get_publishers_info_by_topic(self._topic):
            if info.topic_type == self._type_name:
                profiles.append(info.qos_profile)
            else:
                self._tell(info.topic_type)
        served = adapted(profiles)
        if served == self._profile:
            return  # they have not found each other yet
        self._profile = served
        self._leaving, self._leaves_at_s = self._subscription, now_s + _HANDOVER_S
        self._subscription = self._subscribe()

    def _tell(self, type_name: str) -> None:
        if type_name not in self._told:
            self._told.add(type_name)
            self._node.get_logger().error(
                f"cannot record {self._topic} of type {type_name}: it is recorded as "
                f"{self._type_name}"
            )

    def _subscribe(self) -> Subscription:
        return self._node.create_subscription(
            message_class(self._type_name),
            self._topic,
            self._on_message,
            self._profile,
            # The handlers of events cost every wake-up, and a publisher that cannot serve the
            # subscription is noticed without them.
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )

    def _on_message(self, data: bytes, info: dict[str, int]) -> None:
        if self._closed:
            return
        if self._leaving is not None:
            key = (info["source_timestamp"], data)
            if key in self._seen:
                return
            self._seen.add(key)
        self._count_lost(info.get("publication_sequence_number"))
        self._receive(data, info)

    def _count_lost(self, number: int | None) -> None:
        """Count what is missing before a message; not where two subscriptions take turns."""
        newest, self._newest = self._newest, None if self._leaving is not None else number
        if newest is None or self._newest is None or self._newest <= newest + 1:
            return
        if self.publisher_count == 1:
            self.lost_count += self._newest - newest - 1

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reception of one topic from all publishers, with any quality of service."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from quad_mpc_ros.messages.topics import LOCKSTEP_DEPTH
from quad_mpc_ros.ros.messages import message_class
from quad_mpc_ros.ros.nodes.bag_qos import strictest_common_profile

_OVERLAP_S = 1.0  # for a new subscription to match the publishers

Receiver = Callable[[bytes, dict[str, int]], None]
"""Called with a serialized message and rclpy's message info."""


class TopicRecorder:
    """A subscription with the strictest quality of service that matches every publisher.

    If the publishers change, a new subscription with the new common quality takes over. Both
    subscriptions receive for a while, so that no message is lost; duplicates are dropped.

    Publishers number their messages. Missing numbers are messages lost in transit, for example on
    a busy processor. Lost messages are counted while there is one publisher, because rclpy does
    not report the publisher of a message.
    """

    def __init__(
        self,
        node: Node,
        *,
        topic: str,
        type_name: str,
        profile: QoSProfile,
        receive: Receiver,
    ) -> None:
        self._node = node
        self._topic = topic
        self.type_name = type_name
        self._receive = receive
        self._leaving: Subscription | None = None
        self._leaves_at_s = 0.0
        self._received_keys: set[tuple[int, bytes]] = set()
        self._recent_keys: deque[tuple[int, bytes]] = deque(maxlen=LOCKSTEP_DEPTH)
        self._reported: set[str] = set()
        self._closed = False
        self._newest: int | None = None
        self.lost_count = 0
        """Number of messages lost in transit."""
        self._profile = profile
        self._followed = 0
        self._subscription = self._subscribe()

    @property
    def publisher_count(self) -> int:
        """Number of matched publishers, 0 until the subscription matches all of them."""
        return self._matched if self._matched <= self._followed else 0

    @property
    def _matched(self) -> int:
        return int(self._subscription.get_publisher_count())

    def close(self) -> None:
        """Stop receiving, also messages that the executor already holds."""
        self._closed = True
        for subscription in (self._subscription, self._leaving):
            if subscription is not None:
                self._node.destroy_subscription(subscription)
        self._leaving = None

    def follow_publishers(self, now_s: float) -> None:
        """Adapt to the current publishers; ``now_s``: monotonic time [s]."""
        if self._leaving is not None:
            if now_s < self._leaves_at_s:
                return
            self._node.destroy_subscription(self._leaving)
            self._leaving = None
            self._received_keys.clear()
        there, matched = self._node.count_publishers(self._topic), self._matched
        if there != self._followed or there > matched:
            self._adapt(now_s)

    def _adapt(self, now_s: float) -> None:
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        self._followed = len(publishers)
        profiles = []
        for info in publishers:
            if info.topic_type == self.type_name:
                profiles.append(info.qos_profile)
            else:
                self._report(info.topic_type)
        served = strictest_common_profile(profiles)
        if not profiles or served == self._profile:
            return
        self._profile = served
        self._received_keys = set(self._recent_keys)  # latched topics deliver them again
        self._leaving, self._leaves_at_s = self._subscription, now_s + _OVERLAP_S
        self._subscription = self._subscribe()

    def _report(self, type_name: str) -> None:
        if type_name not in self._reported:
            self._reported.add(type_name)
            self._node.get_logger().error(
                f"cannot record {self._topic} of type {type_name}: the topic is recorded as "
                f"{self.type_name}"
            )

    def _subscribe(self) -> Subscription:
        return self._node.create_subscription(
            message_class(self.type_name),
            self._topic,
            self._on_message,
            self._profile,
            # Event handlers cost time per wake-up; incompatible publishers are detected without.
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )

    def _on_message(self, data: bytes, info: dict[str, int]) -> None:
        if self._closed:
            return
        key = (info["source_timestamp"], data)
        if self._leaving is not None:
            if key in self._received_keys:
                return
            self._received_keys.add(key)
        self._recent_keys.append(key)
        self._count_lost(info.get("publication_sequence_number"))
        self._receive(data, info)

    def _count_lost(self, number: int | None) -> None:
        """Count missing numbers before a message, unless two subscriptions overlap."""
        newest, self._newest = self._newest, None if self._leaving is not None else number
        if newest is None or self._newest is None or self._newest <= newest + 1:
            return
        if self.publisher_count == 1:
            self.lost_count += self._newest - newest - 1

"""The health of a node on ``/diagnostics``: once a second, and at once when a peer joins.

The counts of matched peers let whoever starts the nodes know when they really hear each other,
which is later than when they exist.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from quad_mpc_ros.ros.conversions import diagnostic_status
from quad_mpc_ros.ros.messages import message_class, new_message
from quad_mpc_ros.ros.qos import qos_of
from quad_mpc_ros.ros.topics import DIAGNOSTICS, Topic

OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"
PEERS_KEY = "peers."
_PERIOD = 1.0


@dataclass(frozen=True, kw_only=True)
class Health:
    """What a node says of itself; ``level`` is one of OK, WARN, ERROR."""

    level: bytes
    text: str
    values: Sequence[tuple[str, str]] = ()


class HealthReporter:
    """Publishes a node's health, and counts the peers of the endpoints made through it."""

    def __init__(self, node: Node, probe: Callable[[], Health]) -> None:
        self._node = node
        self._probe = probe
        self._endpoints: dict[str, Publisher | Subscription] = {}
        self._publisher = node.create_publisher(
            message_class(DIAGNOSTICS.type_name),
            DIAGNOSTICS.name,
            qos_of(DIAGNOSTICS),
            event_callbacks=PublisherEventCallbacks(matched=self._on_match),
        )
        # A steady clock: in simulated time the health of a node that waits matters most.
        self._timer = node.create_timer(
            _PERIOD, self.report, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def publisher(self, topic: Topic) -> Publisher:
        """Create a publisher whose matched subscriptions are reported."""
        endpoint = self._node.create_publisher(
            message_class(topic.type_name),
            topic.name,
            qos_of(topic),
            event_callbacks=PublisherEventCallbacks(matched=self._on_match),
        )
        self._endpoints[topic.name] = endpoint
        return endpoint

    def subscription(
        self, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False
    ) -> None:
        """Create a subscription whose matched publishers are reported; ``raw`` gives bytes."""
        self._endpoints[topic.name] = self._node.create_subscription(
            message_class(topic.type_name),
            topic.name,
            callback,
            qos_of(topic),
            event_callbacks=SubscriptionEventCallbacks(matched=self._on_match),
            raw=raw,
        )

    def destroy_endpoints(self) -> None:
        """Destroy what was created through it; the health itself is reported on."""
        for endpoint in self._endpoints.values():
            if isinstance(endpoint, Publisher):
                self._node.destroy_publisher(endpoint)
            else:
                self._node.destroy_subscription(endpoint)
        self._endpoints.clear()

    def report(self) -> None:
        """Publish the health now."""
        health = self._probe()
        message = new_message(DIAGNOSTICS.type_name)
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            diagnostic_status(
                name=self._node.get_fully_qualified_name(),
                level=health.level,
                text=health.text,
                values=[*self._peers(), *health.values],
                new=new_message,
            )
        ]
        self._publisher.publish(message)

    def _on_match(self, _: object) -> None:
        self.report()

    def _peers(self) -> list[tuple[str, str]]:
        return [
            (f"{PEERS_KEY}{name}", str(_peer_count(endpoint)))
            for name, endpoint in self._endpoints.items()
        ]


def _peer_count(endpoint: Publisher | Subscription) -> int:
    if isinstance(endpoint, Publisher):
        return int(endpoint.get_subscription_count())
    return int(endpoint.get_publisher_count())

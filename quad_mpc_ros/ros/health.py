"""The health of a node on ``/diagnostics``: once a second, and when a peer joins or leaves.

The counts of matched peers show when nodes are really connected, which is later than when they
exist.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from quad_mpc_ros.configuration import Configuration
from quad_mpc_ros.messages import cdr
from quad_mpc_ros.messages.diagnostics import WARN
from quad_mpc_ros.messages.topics import DIAGNOSTICS, Topic
from quad_mpc_ros.ros.clocks import create_steady_timer
from quad_mpc_ros.ros.messages import message_class, qos_of
from quad_mpc_ros.ros.parameters import ParameterNode, declare
from quad_mpc_ros.ros.spin import until_the_end
from quad_mpc_ros.ros.vehicle_watch import VEHICLE_KEY, VehicleWatch, vehicle_text

C = TypeVar("C", bound=Configuration)

PEERS_KEY = "peers."
_PERIOD = 1.0
_POLL_PERIOD = 0.1


@dataclass(frozen=True, kw_only=True)
class Health:
    """The health of a node; ``level`` is OK, WARN or ERROR of ``messages.diagnostics``."""

    level: bytes
    text: str
    values: Sequence[tuple[str, str]] = ()


class HealthReporter:
    """Publishes a node's health, and counts the peers of the endpoints made through it.

    It polls the counts ten times a second. rclpy's events for that cannot be used: its events
    executor crashes when an endpoint with a handler of such events is destroyed.
    """

    def __init__(self, node: Node, probe: Callable[[], Health]) -> None:
        self._node = node
        self._probe = probe
        self._endpoints: dict[str, Publisher | Subscription] = {}
        self._others: dict[str, Subscription] = {}
        self._single: set[str] = set()
        self._counted: list[tuple[str, str]] = []
        self._reported_s = 0.0
        self._unmatched: set[str] = set()
        self._reported: set[str] = set()
        self.vehicle: Mapping[str, Any] = {}
        """What the node was given of the vehicle, to be compared with the others'."""
        self.watch: VehicleWatch | None = None
        self._publisher = self._create_publisher(DIAGNOSTICS)
        # Steady: when simulated time stands still, the health of a node matters most.
        create_steady_timer(node, _POLL_PERIOD, self._poll)

    def publisher(self, topic: Topic) -> Publisher:
        """Create a publisher whose matched subscriptions are reported."""
        endpoint = self._endpoints[topic.name] = self._create_publisher(topic)
        return endpoint

    def subscription(
        self,
        topic: Topic,
        callback: Callable[[Any], None],
        *,
        raw: bool = False,
        expected: bool = True,
    ) -> None:
        """Create a subscription; with ``raw`` the callback gets bytes.

        Its matched publishers are reported if some are ``expected``.
        """
        endpoints = self._endpoints if expected else self._others
        if topic.single_source:
            self._single.add(topic.name)
        endpoints[topic.name] = self._node.create_subscription(
            message_class(topic.type_name),
            topic.name,
            until_the_end(self._node, callback),
            qos_of(topic),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=raw,
        )

    def destroy_endpoints(self) -> None:
        """Destroy the endpoints created through it; the health is still reported."""
        for endpoint in (*self._endpoints.values(), *self._others.values()):
            if isinstance(endpoint, Publisher):
                self._node.destroy_publisher(endpoint)
            else:
                self._node.destroy_subscription(endpoint)
        self._endpoints.clear()
        self._others.clear()

    def report(self) -> None:
        """Publish the health now."""
        health, peers = self._with_faults(self._probe()), self._peers()
        message = cdr.written_diagnostics(
            stamp_ns=self._node.get_clock().now().nanoseconds,
            level=health.level,
            name=self._node.get_fully_qualified_name(),
            text=health.text,
            values=[*peers, *health.values, *self._vehicle()],
        )
        self._publisher.publish(message)
        self._reported_s, self._counted = time.monotonic(), peers

    def rivals(self) -> str:
        """Return which topics have several publishers where there must be one; empty if none."""
        rivals = [
            f"{count} publishers on {name}"
            for name in sorted(self._single & self._endpoints.keys())
            if (count := _peer_count(self._endpoints[name])) > 1
        ]
        return f"{', '.join(rivals)}, expected one" if rivals else ""

    def publishers_of(self, topic: Topic) -> str:
        """Return in words what publishes on a subscribed topic, and why it is not heard."""
        endpoint = self._endpoints[topic.name]
        assert isinstance(endpoint, Subscription)
        found = self._node.get_publishers_info_by_topic(endpoint.topic_name)
        name = str(endpoint.topic_name)
        if not found:
            return f"no publisher on {name}"
        misfits = [why for each in found if (why := _misfit(each, topic))]
        count = f"{len(found)} publisher{'s' if len(found) > 1 else ''} on {name}"
        if misfits:
            return f"{count}, not heard: {'; '.join(misfits)}"
        return f"{count}, nothing received"

    def _with_faults(self, health: Health) -> Health:
        """Return the health with a warning of rival publishers and of different vehicles."""
        vehicles = self.watch.fault() if self.watch is not None else ""
        faults = [fault for fault in (self.rivals(), vehicles) if fault]
        if not faults:
            return health
        text = "; ".join([*faults, health.text])
        return replace(health, level=max(health.level, WARN), text=text)

    def _create_publisher(self, topic: Topic) -> Publisher:
        return self._node.create_publisher(
            message_class(topic.type_name),
            topic.name,
            qos_of(topic),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        )

    def _vehicle(self) -> list[tuple[str, str]]:
        return [(VEHICLE_KEY, vehicle_text(self.vehicle))] if self.vehicle else []

    def _poll(self) -> None:
        due = time.monotonic() - self._reported_s >= _PERIOD
        if due:
            self._report_mismatches()
        if due or self._peers() != self._counted:
            self.report()

    def _report_mismatches(self) -> None:
        """Warn once of a topic where a peer has existed for a period without being matched."""
        unmatched = {
            name
            for name, endpoint in self._endpoints.items()
            if _peer_count(endpoint) < self._known_peer_count(endpoint)
        }
        for name in sorted(unmatched & self._unmatched - self._reported):
            self._reported.add(name)
            self._node.get_logger().warning(
                f"{name}: a peer on this topic is not matched, its quality of service or type "
                "differs: compare them with ros2 topic info --verbose"
            )
        self._unmatched = unmatched

    def _known_peer_count(self, endpoint: Publisher | Subscription) -> int:
        """Return how many peers the graph knows, matched or not."""
        if isinstance(endpoint, Publisher):
            return int(self._node.count_subscribers(endpoint.topic_name))
        return int(self._node.count_publishers(endpoint.topic_name))

    def _peers(self) -> list[tuple[str, str]]:
        return [
            (f"{PEERS_KEY}{name}", str(_peer_count(endpoint)))
            for name, endpoint in self._endpoints.items()
        ]


class ReportingNode(ParameterNode, Generic[C]):
    """A node without a lifecycle.

    A derived node makes its endpoints through ``health`` and overrides :meth:`report`. It sets
    ``exit_code`` to end with another one than 0.
    """

    def __init__(self, name: str, configuration: type[C]) -> None:
        """Declare the parameters. Raises :class:`ConfigurationError` for bad values."""
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.exit_code = 0
        self.config = declare(self, configuration)
        self.health = HealthReporter(self, self.report)
        self.health.vehicle = self.config.vehicle_values()

    def report(self) -> Health:
        """Return the health of the node."""
        raise NotImplementedError


def _misfit(publisher: TopicEndpointInfo, topic: Topic) -> str:
    """Return why a publisher cannot be heard, empty if it can."""
    node = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
    if publisher.topic_type != topic.type_name:
        return f"{node} publishes {publisher.topic_type}, expected {topic.type_name}"
    fits, why = qos_check_compatible(publisher.qos_profile, qos_of(topic))
    if fits == QoSCompatibility.ERROR:
        return f"quality of service of {node}: {why.strip().rstrip(';').lower()}"
    return ""


def _peer_count(endpoint: Publisher | Subscription) -> int:
    """Return how many peers are matched."""
    if isinstance(endpoint, Publisher):
        return int(endpoint.get_subscription_count())
    return int(endpoint.get_publisher_count())

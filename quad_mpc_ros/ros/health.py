# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Health of a node on ``/diagnostics``, once a second and when a peer joins or leaves.

The counts of matched peers show when nodes are connected, which is later than their start.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription

from quad_mpc_ros.configuration import Configuration
from quad_mpc_ros.messages import cdr
from quad_mpc_ros.messages.diagnostics import PEERS_KEY, WARN
from quad_mpc_ros.messages.topics import DIAGNOSTICS, Topic
from quad_mpc_ros.ros.clocks import create_steady_timer
from quad_mpc_ros.ros.messages import message_class, qos_of
from quad_mpc_ros.ros.parameters import declare
from quad_mpc_ros.ros.spin import until_the_end
from quad_mpc_ros.ros.vehicle_watch import VEHICLE_KEY, VehicleWatch

C = TypeVar("C", bound=Configuration)

_REPORT_PERIOD = 1.0
_POLL_PERIOD = 0.1


@dataclass(frozen=True, kw_only=True)
class Health:
    """Health of a node; ``level`` is OK, WARN or ERROR of ``messages.diagnostics``."""

    level: bytes
    text: str
    values: Sequence[tuple[str, str]] = ()


class _Endpoint(NamedTuple):
    """A publisher or subscription of the node; ``expected``: it should have peers."""

    topic: Topic
    entity: Publisher | Subscription
    expected: bool

    def peer_count(self) -> int:
        """Return the number of matched peers."""
        if isinstance(self.entity, Publisher):
            return int(self.entity.get_subscription_count())
        return int(self.entity.get_publisher_count())

    def known_peers(self, node: Node) -> list[Any]:
        """Return the peers in the graph, matched or not."""
        if isinstance(self.entity, Publisher):
            return list(node.get_subscriptions_info_by_topic(self.entity.topic_name))
        return list(node.get_publishers_info_by_topic(self.entity.topic_name))

    def mismatches(self, node: Node) -> list[str]:
        """Return the reasons why known peers cannot be matched, each once."""
        name = self.entity.topic_name
        publishes = isinstance(self.entity, Publisher)
        known = node.count_subscribers(name) if publishes else node.count_publishers(name)
        if self.peer_count() >= known:  # as usual: the list of peers takes longer
            return []
        return sorted({why for peer in self.known_peers(node) if (why := self.mismatch(peer))})

    def mismatch(self, peer: Any) -> str:
        """Return the reason why a peer cannot be matched, or an empty string."""
        publishes = isinstance(self.entity, Publisher)
        node = f"{peer.node_namespace.rstrip('/')}/{peer.node_name}"
        if peer.topic_type != self.topic.type_name:
            verb = "subscribes to" if publishes else "publishes"
            return f"{node} {verb} {peer.topic_type}, expected {self.topic.type_name}"
        ours, theirs = qos_of(self.topic), peer.qos_profile
        fits, why = qos_check_compatible(*((ours, theirs) if publishes else (theirs, ours)))
        if fits == QoSCompatibility.ERROR:
            return f"quality of service of {node}: {why.strip().rstrip(';').lower()}"
        return ""


class HealthReporter:
    """Publishes a node's health and counts the peers of the endpoints that it creates.

    The counts are polled at 10 Hz, because rclpy's events executor crashes when an endpoint with a
    handler of matched events is destroyed.
    """

    def __init__(self, node: Node, probe: Callable[[], Health]) -> None:
        self._node = node
        self._probe = probe
        self._endpoints: dict[str, _Endpoint] = {}
        self._reported_peers: list[tuple[str, str]] = []
        self._reported_s = 0.0
        self._mismatches: list[str] = []
        self._logged: set[str] = set()
        self.vehicle: Mapping[str, Any] = {}
        """The configured vehicle of the node, for comparison with other nodes."""
        self.watch: VehicleWatch | None = None
        self.lockstep = False
        """Whether publishers are reliable, as in lockstep, where no message may be lost."""
        self._publisher = self._create_publisher(DIAGNOSTICS)
        # Steady: health must be reported also while simulated time is stopped.
        create_steady_timer(node, _POLL_PERIOD, self._poll)

    def publisher(self, topic: Topic) -> Publisher:
        """Create a publisher whose matched subscriptions are reported."""
        entity = self._create_publisher(topic)
        self._endpoints[topic.name] = _Endpoint(topic, entity, expected=True)
        return entity

    def subscription(
        self,
        topic: Topic,
        callback: Callable[[Any], None],
        *,
        raw: bool = False,
        expected: bool = True,
    ) -> None:
        """Create a subscription; with ``raw`` the callback receives bytes.

        Matched publishers are counted if ``expected``; incompatible ones are always reported.
        """
        entity = self._node.create_subscription(
            message_class(topic.type_name),
            topic.name,
            until_the_end(self._node, callback),
            qos_of(topic),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=raw,
        )
        self._endpoints[topic.name] = _Endpoint(topic, entity, expected)

    def destroy_endpoints(self) -> None:
        """Destroy the created endpoints; the health is still reported."""
        for endpoint in self._endpoints.values():
            if isinstance(endpoint.entity, Publisher):
                self._node.destroy_publisher(endpoint.entity)
            else:
                self._node.destroy_subscription(endpoint.entity)
        self._endpoints.clear()
        self._mismatches = []

    def report(self) -> None:
        """Publish the health now, with faults of peers and of other nodes."""
        health, peers = self._probe(), self.peers()
        vehicles = self.watch.fault() if self.watch is not None else ""
        faults = list(filter(None, (self.duplicate_publishers(), vehicles, *self._mismatches)))
        vehicle = [(VEHICLE_KEY, json.dumps(self.vehicle))] if self.vehicle else []
        message = cdr.written_diagnostics(
            stamp_ns=self._node.get_clock().now().nanoseconds,
            level=max(health.level, WARN) if faults else health.level,
            name=self._node.get_fully_qualified_name(),
            text="; ".join([*faults, health.text]),
            values=[*peers, *health.values, *vehicle],
            hardware_id=self._node.get_namespace().strip("/") or "vehicle",
        )
        self._publisher.publish(message)
        self._reported_s, self._reported_peers = time.monotonic(), peers

    def peers(self) -> list[tuple[str, str]]:
        """Return the number of matched peers of each endpoint, as reported."""
        return [
            (f"{PEERS_KEY}{name}", str(endpoint.peer_count()))
            for name, endpoint in self._endpoints.items()
            if endpoint.expected
        ]

    def duplicate_publishers(self) -> str:
        """Return the topics with duplicate publishers, or an empty string."""
        found = [
            f"{count} publishers on {name}"
            for name, endpoint in sorted(self._endpoints.items())
            if isinstance(endpoint.entity, Subscription)
            and endpoint.expected
            and endpoint.topic.single_source
            and (count := endpoint.peer_count()) > 1
        ]
        return f"{', '.join(found)}, expected one" if found else ""

    def publishers_of(self, topic: Topic) -> str:
        """Return a text with the publishers of a subscribed topic and their incompatibilities."""
        endpoint = self._endpoints[topic.name]
        name, found = str(endpoint.entity.topic_name), endpoint.known_peers(self._node)
        if not found:
            return f"no publisher on {name}"
        mismatches = [why for each in found if (why := endpoint.mismatch(each))]
        count = f"{len(found)} publisher{'s' if len(found) > 1 else ''} on {name}"
        if mismatches:
            return f"{count}, not received: {'; '.join(mismatches)}"
        return f"{count}, nothing received"

    def _create_publisher(self, topic: Topic) -> Publisher:
        if self.lockstep:
            topic = topic.in_lockstep()
        return self._node.create_publisher(
            message_class(topic.type_name),
            topic.name,
            qos_of(topic),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        )

    def _poll(self) -> None:
        due = time.monotonic() - self._reported_s >= _REPORT_PERIOD
        if due:
            self._find_mismatches()
        if due or self.peers() != self._reported_peers:
            self.report()

    def _find_mismatches(self) -> None:
        """Find peers that cannot be matched; log each once."""
        self._mismatches = [
            f"{name}: {why}; messages are not delivered"
            for name, endpoint in sorted(self._endpoints.items())
            for why in endpoint.mismatches(self._node)
        ]
        for mismatch in self._mismatches:
            if mismatch not in self._logged:
                self._logged.add(mismatch)
                self._node.get_logger().warning(mismatch)


class ReportingNode(Node, Generic[C]):
    """A node without a lifecycle.

    A derived node creates its endpoints with ``health`` and overrides :meth:`report`.
    ``exit_code`` sets an exit code other than 0.
    """

    def __init__(self, name: str, configuration: type[C]) -> None:
        """Declare the parameters. Raises :class:`ConfigurationError` for invalid values."""
        super().__init__(name)
        self.exit_code = 0
        self.config = declare(self, configuration)
        self.health = HealthReporter(self, self.report)
        self.health.vehicle = self.config.vehicle_values()

    def report(self) -> Health:
        """Return the health of the node."""
        raise NotImplementedError

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Ensures that one node commands the vehicle of a namespace.

Each MPC reports on ``/diagnostics`` its command topic and the start of its activity. An MPC
refuses activation while another MPC is active on that topic or another node publishes commands.
Nodes discover each other one by one, so an MPC waits for one second after the first message of
another node, and at most three seconds.

Two MPCs that start at the same moment, or that discover each other after more than three seconds,
both command until they have received each other's report. Then the MPC that started later stops.
An MPC that has been in command for ten seconds never yields.
"""

from __future__ import annotations

import math
import os
import secrets
import socket
import time
from typing import NamedTuple

from rclpy.node import Node
from rclpy.publisher import Publisher

from quad_mpc_ros.messages.topics import DIAGNOSTICS
from quad_mpc_ros.ros.messages import message_in

_TOPIC, _INSTANCE, _SINCE = "commands.topic", "commands.instance", "commands.since_ns"
DISCOVERING = "commands.discovering"
"""Key on ``/diagnostics``: whether the node still waits for the discovery of other nodes."""
_TOPIC_MARK = _TOPIC.encode() + b"\0"
# s: an MPC that has been in command for longer never yields.
_YIELD_PERIOD = 10.0
_REPORT_TIMEOUT = 3.0  # s without a report: the node has ended
# s: time for discovery; time for discovery after the first message of another node.
_DISCOVERY_TIME, _DISCOVERY_AFTER_FIRST = 3.0, 1.0


class _OtherMpc(NamedTuple):
    """Another MPC on the topic; ``since_ns`` is None while it is inactive."""

    node: str
    since_ns: int | None
    received_s: float


class CommandOwnership:
    """Tracks other nodes that command the vehicle, and the right of this node to do so."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._instance = f"{socket.gethostname()}:{os.getpid()}:{secrets.token_hex(4)}"
        self._since_ns: int | None = None  # system clock, for other nodes
        self._began_s = 0.0
        self._others: dict[str, _OtherMpc] = {}
        self._publisher: Publisher | None = None
        self._waits = True
        self._discovery_ends = math.inf  # until it subscribes
        self._received_any = False

    def note_message(self) -> None:
        """Record that a message of another node was received: discovery works."""
        if not self._received_any:
            self._received_any = True
            ends = time.monotonic() + _DISCOVERY_AFTER_FIRST
            self._discovery_ends = min(self._discovery_ends, ends)

    def watch(self, command: Publisher | None, *, waits: bool = True) -> None:
        """Set the node's command publisher, or None after it was destroyed.

        In lockstep, in simulation, discovery of other nodes is not awaited (``waits`` false).
        """
        self._publisher, self._waits = command, waits
        self.end()
        if command is not None and math.isinf(self._discovery_ends):
            self._discovery_ends = time.monotonic() + _DISCOVERY_TIME

    def begin(self) -> None:
        """Record that the node becomes active."""
        self._since_ns, self._began_s = time.time_ns(), time.monotonic()

    def end(self) -> None:
        """Record that the node becomes inactive."""
        self._since_ns = None

    def values(self) -> list[tuple[str, str]]:
        """Return the values to publish on ``/diagnostics``."""
        if self._publisher is None:
            return []
        since = "" if self._since_ns is None else str(self._since_ns)
        return [
            (_TOPIC, self._publisher.topic_name),
            (_INSTANCE, self._instance),
            (_SINCE, since),
            (DISCOVERING, str(self._waits and self.is_discovering).lower()),
        ]

    def receive(self, data: bytes) -> str:
        """Process a raw message of ``/diagnostics``.

        Returns:
            The reason why this node must stop, or an empty string.
        """
        if not self._received_any and self._node.get_fully_qualified_name().encode() not in data:
            self.note_message()
        if _TOPIC_MARK not in data or self._publisher is None:
            return ""
        for status in message_in(DIAGNOSTICS, data).status:
            values = {entry.key: entry.value for entry in status.values}
            instance, since = values.get(_INSTANCE, self._instance), values.get(_SINCE, "")
            if values.get(_TOPIC) != self._publisher.topic_name or instance == self._instance:
                continue
            self._others[instance] = other = _OtherMpc(
                node=f"{status.name} ({instance})",
                since_ns=int(since) if since.isdecimal() else None,
                received_s=time.monotonic(),
            )
            if other.since_ns is not None and self._is_later_than(other.since_ns, instance):
                return f"{other.node} has been in command for longer: this node stops"
        return ""

    def _is_later_than(self, since_ns: int, instance: str) -> bool:
        """Return whether this node must yield: recently activated, and after the other node."""
        if self._since_ns is None or time.monotonic() - self._began_s > _YIELD_PERIOD:
            return False
        return (since_ns, instance) < (self._since_ns, self._instance)

    def activation_blocker(self) -> str | None:
        """Return the reason why this node must not start to command, or None."""
        if (active := self._active()) is not None:
            return f"{active} is already publishing commands: stop or deactivate it first"
        if self._waits and self.is_discovering:
            return "other nodes are still being discovered"
        publishers = self._publishers()
        if len(publishers) > len(self._recent_mpcs()):
            return (
                f"{', '.join(publishers)} can publish {self._topic} as well: stop the other "
                "node first; discovery drops a killed node after about 20 s"
            )
        return None

    @property
    def is_discovering(self) -> bool:
        """Whether the discovery of other nodes is not complete yet."""
        return time.monotonic() < self._discovery_ends

    def is_taken(self) -> bool:
        """Return whether another MPC is known to be active."""
        return self._active() is not None

    def fault(self) -> str:
        """Return an error with the other command publishers, or an empty string."""
        publishers = self._publishers()
        count = f"{1 + len(publishers)} publishers on {self._topic}, expected one"
        return f"{count}: also {', '.join(publishers)}" if publishers else ""

    @property
    def _topic(self) -> str:
        return "" if self._publisher is None else str(self._publisher.topic_name)

    def _recent_mpcs(self) -> list[_OtherMpc]:
        """Return the other MPCs with a recent report."""
        since = time.monotonic() - _REPORT_TIMEOUT
        return [other for other in self._others.values() if other.received_s > since]

    def _active(self) -> str | None:
        mpcs = self._recent_mpcs()
        return next((other.node for other in mpcs if other.since_ns is not None), None)

    def _publishers(self) -> list[str]:
        """Return the nodes with other publishers on the command topic."""
        if self._publisher is None or self._node.count_publishers(self._topic) <= 1:
            return []
        names = [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(self._topic)
        ]
        own = self._node.get_fully_qualified_name()
        if own in names:  # once: another node may have the same name
            names.remove(own)
        return sorted(names)

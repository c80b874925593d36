"""Who else commands the vehicle: there must be one source of commands in a namespace.

Each MPC reports on ``/diagnostics`` on which topic it commands, and since when. One that is to be
activated is refused while another is active there, or while another node publishes commands.
For that it waits for a second after the first message of another node, at most three after it
begins to listen: nodes find each other one by one.

Before an MPC starts by itself it publishes a claim, and waits until every other MPC that it knows
has granted it. An MPC grants a claim unless it is active, or claims the same and its identity
sorts first; while a claim that it has granted stands it does not begin itself. So one begins at
most of those that know each other, whatever the order of their messages.
Two that need longer than three seconds to find each other, or that were asked to activate at the
same moment, both command until one has the other's next report: then the one that began later
stops. After ten seconds none stops any more.
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
from quad_mpc_ros.ros.messages import decoded

_TOPIC, _INSTANCE, _SINCE = "commands.topic", "commands.instance", "commands.since_ns"
_CLAIM, _GRANTED = "commands.claim", "commands.granted"
DISCOVERING = "commands.discovering"
"""Whether the node waits to know who else commands, of its values on ``/diagnostics``."""
_TOPIC_MARK = _TOPIC.encode() + b"\0"
# s: an MPC that has been in command for longer never yields, whatever others claim.
_YIELD_PERIOD = 10.0
_REPORT_TIMEOUT = 3.0  # s without a report: it has ended
# s: until a node that listens has found all others, or from the first message of another.
_DISCOVERY_TIME, _DISCOVERY_AFTER_FIRST = 3.0, 1.0


class _OtherMpc(NamedTuple):
    """Another MPC of the topic: its node, since when it is active [ns], if it is, when heard."""

    node: str
    since_ns: int | None
    claim: str
    granted: list[str]
    received_s: float


class CommandOwnership:
    """Knows the other sources of commands of a node."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._instance = f"{socket.gethostname()}:{os.getpid()}:{secrets.token_hex(4)}"
        self._since_ns: int | None = None  # by the system's clock, for others
        self._began_s = 0.0
        self._others: dict[str, _OtherMpc] = {}
        self._publisher: Publisher | None = None
        self._waits = True
        self._discovery_ends = math.inf  # until it listens
        self._received_any = False
        self._claim = ""
        self._granted: dict[str, str] = {}  # claims of others, by instance

    def note_message(self) -> None:
        """Take note that a message has come from another node: discovery works."""
        if not self._received_any:
            self._received_any = True
            ends = time.monotonic() + _DISCOVERY_AFTER_FIRST
            self._discovery_ends = min(self._discovery_ends, ends)

    def watch(self, command: Publisher | None, *, waits: bool = True) -> None:
        """Take the publisher of the node's own commands, or that there is none any more.

        In lockstep, in simulation, it need not wait for others to be discovered.
        """
        self._publisher, self._waits = command, waits
        self.end()
        if command is not None and math.isinf(self._discovery_ends):
            self._discovery_ends = time.monotonic() + _DISCOVERY_TIME

    def claim(self, wanted: bool) -> bool:
        """Claim to begin, or withdraw the claim; return whether that is to be published."""
        if wanted == bool(self._claim):
            return False
        self._claim = secrets.token_hex(4) if wanted else ""
        return True

    @property
    def is_claiming(self) -> bool:
        """Whether the node claims to begin."""
        return bool(self._claim)

    def claim_is_granted(self) -> bool:
        """Whether all other MPCs have granted the claim."""
        return all(self._claim in other.granted for other in self._recent_mpcs())

    def begin(self) -> None:
        """Take note that the node is active from now on."""
        self._since_ns, self._began_s = time.time_ns(), time.monotonic()
        self._claim = ""
        self._granted.clear()

    def end(self) -> None:
        """Take note that it is not active any more."""
        self._since_ns, self._claim = None, ""

    def values(self) -> list[tuple[str, str]]:
        """Return what the others are to know, for the node's health."""
        if self._publisher is None:
            return []
        since = "" if self._since_ns is None else str(self._since_ns)
        return [
            (_TOPIC, self._publisher.topic_name),
            (_INSTANCE, self._instance),
            (_SINCE, since),
            (_CLAIM, self._claim),
            (_GRANTED, " ".join(self._granted.values())),
            (DISCOVERING, str(self._waits and self.is_discovering).lower()),
        ]

    def receive(self, data: bytes) -> str:
        """Take a raw message of ``/diagnostics``.

        Returns:
            Why this node has to stop, empty if it does not.
        """
        if not self._received_any and self._node.get_fully_qualified_name().encode() not in data:
            self.note_message()
        if _TOPIC_MARK not in data or self._publisher is None:
            return ""
        for status in decoded(DIAGNOSTICS, data).status:
            values = {entry.key: entry.value for entry in status.values}
            instance, since = values.get(_INSTANCE, self._instance), values.get(_SINCE, "")
            if values.get(_TOPIC) != self._publisher.topic_name or instance == self._instance:
                continue
            since_ns = int(since) if since.isdecimal() else None
            other = _OtherMpc(
                node=f"{status.name} ({instance})",
                since_ns=since_ns,
                claim=values.get(_CLAIM, ""),
                granted=values.get(_GRANTED, "").split(),
                received_s=time.monotonic(),
            )
            self._others[instance] = other
            self._answer(instance, other.claim)
            if since_ns is not None:
                self._claim = ""
            if since_ns is not None and self._is_later_than(since_ns, instance):
                return f"{other.node} has commanded for longer: this node stops"
        return ""

    def _answer(self, instance: str, claim: str) -> None:
        """Grant the claim of another MPC, or take the grant back when the claim is over."""
        first = not self._claim or instance < self._instance
        if claim and self._since_ns is None and first:
            self._granted[instance] = claim
        else:
            self._granted.pop(instance, None)

    def _is_later_than(self, since_ns: int, instance: str) -> bool:
        """Whether this node has been active for a short time, and began later than another one."""
        if self._since_ns is None or time.monotonic() - self._began_s > _YIELD_PERIOD:
            return False
        return (since_ns, instance) < (self._since_ns, self._instance)

    def activation_blocker(self) -> str | None:
        """Return why this node must not begin to command, or None."""
        if (active := self._active()) is not None:
            return f"{active} commands already: end or deactivate it first"
        if self._waits and self.is_discovering:
            return "other nodes are still being discovered"
        if (claimant := self._claimant()) is not None:
            return f"{claimant} is about to command"
        publishers = self._publishers()
        if len(publishers) > len(self._recent_mpcs()):
            return (
                f"{', '.join(publishers)} can publish {self._topic} as well: end it first; one "
                "that was killed is forgotten after some 20 s"
            )
        return None

    @property
    def is_discovering(self) -> bool:
        """Whether the node has not been there for long enough to know who else is."""
        return time.monotonic() < self._discovery_ends

    def is_taken(self) -> bool:
        """Whether another one is known to command."""
        return self._active() is not None

    def fault(self) -> str:
        """Return the other nodes that could command, empty if there are none."""
        publishers = self._publishers()
        if not publishers:
            return ""
        return (
            f"{1 + len(publishers)} publishers on {self._topic}, expected one: "
            f"also {', '.join(publishers)}"
        )

    @property
    def _topic(self) -> str:
        return "" if self._publisher is None else str(self._publisher.topic_name)

    def _recent_mpcs(self) -> list[_OtherMpc]:
        """Return the other MPCs that have reported lately."""
        since = time.monotonic() - _REPORT_TIMEOUT
        return [other for other in self._others.values() if other.received_s > since]

    def _active(self) -> str | None:
        mpcs = self._recent_mpcs()
        return next((other.node for other in mpcs if other.since_ns is not None), None)

    def _claimant(self) -> str | None:
        """Return another MPC whose claim to begin this node has granted."""
        known = self._recent_mpcs()
        granted = (self._others[instance] for instance in self._granted)
        return next((other.node for other in granted if other in known), None)

    def _publishers(self) -> list[str]:
        """Return the nodes of the other publishers of commands."""
        if self._publisher is None or self._node.count_publishers(self._topic) <= 1:
            return []
        names = [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(self._topic)
        ]
        own = self._node.get_fully_qualified_name()
        if own in names:  # another one may have the same name
            names.remove(own)
        return sorted(names)

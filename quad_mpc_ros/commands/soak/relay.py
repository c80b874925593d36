"""Between publisher and MPC: passes a topic on, unchanged or distorted by a fault."""

from __future__ import annotations

import bisect
import dataclasses
import functools
import heapq
import itertools
import time
from collections.abc import Callable
from typing import Any, Generic, NamedTuple

from rclpy.node import Node

from quad_mpc_ros.commands.observer import subscribe
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.experiments.faults.distortions import Distortion, M
from quad_mpc_ros.messages import cdr, conversions
from quad_mpc_ros.messages.topics import ODOMETRY, REFERENCE, Topic
from quad_mpc_ros.ros.messages import decoded, message_class, qos_of

PREFIX = "soak/"
_BODY_FRAME = "base_link"


class Passed(NamedTuple):
    """When a message was passed on, by the system's clock [ns], and its stamp [ns]."""

    when_ns: int
    stamp_ns: int


class Relay(Generic[M]):
    """Subscribes to a topic and publishes it again as ``soak/<topic>``.

    Messages are passed on as bytes; only during a fault they are decoded.
    """

    def __init__(
        self,
        node: Node,
        topic: Topic,
        *,
        read: Callable[[Any], M],
        write: Callable[[M], bytes],
    ) -> None:
        self._node, self._topic = node, topic
        self._read: Callable[[Any], M] = read
        self._encode: Callable[[M], bytes] = write
        self._publisher = self._publisher_again()
        self._intruder: Any = None
        self._last = b""
        self.passed: list[Passed] = []
        """Which messages were passed on untouched."""
        self.last_received_ns = 0
        """When the last message was received, passed on or not."""
        self._fault: Distortion[M] | None = None
        self._before: M | None = None
        self._began_ns = 0
        self._shift_ns = 0
        self._waiting: list[tuple[int, int, Any, bytes]] = []
        self._order = itertools.count()
        subscribe(node, topic, self._on_message, raw=True)

    @property
    def last(self) -> M | None:
        """The last message that came, without its fault."""
        return self._decode(self._last) if self._last else None

    def starved_since(self, when_ns: int) -> list[tuple[int, int]]:
        """Return from which stamp on, until when, the MPC knew no newer message, for each."""
        first = bisect.bisect_left(self.passed, when_ns, key=lambda passed: passed.when_ns)
        return [
            (one.stamp_ns, other.when_ns) for one, other in itertools.pairwise(self.passed[first:])
        ]

    @property
    def matched(self) -> bool:
        """Whether the MPC is subscribed."""
        publishers = [p for p in (self._publisher, self._intruder) if p is not None]
        return all(p.get_subscription_count() for p in publishers)

    def begin(self, fault: Distortion[M]) -> None:
        """Let the fault begin."""
        self._before, self._began_ns, self._fault = self.last, time.time_ns(), fault

    def end(self) -> None:
        """End whatever was done to the messages; what is held back comes when it is due."""
        self._fault, self._shift_ns = None, 0
        if self._intruder is not None:
            self._node.destroy_publisher(self._intruder)
            self._intruder = None

    def shift(self, seconds: float) -> None:
        """Shift the stamps, as of clocks that were set."""
        self._shift_ns = round(seconds * 1e9)

    def intrude(self) -> None:
        """Make the second publisher."""
        self._intruder = self._publisher_again()

    def release(self) -> None:
        """Publish what was held back and is due."""
        while self._waiting and self._waiting[0][0] <= time.time_ns():
            _, _, publisher, data = heapq.heappop(self._waiting)
            publisher.publish(data)

    def _on_message(self, data: bytes) -> None:
        now_ns = self.last_received_ns = time.time_ns()
        self._last = data
        if self._fault is not None and self._before is not None:
            self._distort(self._fault, self._before, self._decode(data), now_ns)
            return
        if self._shift_ns:
            message = self._decode(data)
            shifted_ns = message.stamp_ns + self._shift_ns
            data = self._encode(dataclasses.replace(message, stamp_ns=shifted_ns))
        self._publisher.publish(data)
        self.passed.append(Passed(now_ns, cdr.header_stamp_ns(data)))

    def _distort(self, fault: Distortion[M], before: M, message: M, now_ns: int) -> None:
        for delivery in fault(message, before, now_ns - self._began_ns):
            publisher = self._intruder if delivery.intruder else self._publisher
            data = self._encode(delivery.message)
            if delivery.delay_ns == 0:
                publisher.publish(data)
            else:
                due_ns = now_ns + delivery.delay_ns
                heapq.heappush(self._waiting, (due_ns, next(self._order), publisher, data))

    def _decode(self, data: bytes) -> M:
        return self._read(decoded(self._topic, data))

    def _publisher_again(self) -> Any:
        return self._node.create_publisher(
            message_class(self._topic.type_name),
            PREFIX + self._topic.name,
            qos_of(self._topic),
        )


def odometry_relay(node: Node) -> Relay[OdometrySample]:
    """Return the relay of the odometry."""
    return Relay(
        node, ODOMETRY, read=conversions.odometry_from_message, write=cdr.written_odometry
    )


def reference_relay(node: Node) -> Relay[ReferenceWindow]:
    """Return the relay of the reference."""
    write = functools.partial(cdr.written_reference, child_frame_id=_BODY_FRAME)
    return Relay(node, REFERENCE, read=conversions.reference_from_message, write=write)

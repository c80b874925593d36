"""A small node of a command, spun from its main thread beside the nodes that fly."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Self

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.messages import message_class, qos_of

_LONGEST_WAIT = 0.05  # s, until a condition is looked at again


class Observer:
    """Base of nodes that watch a flight: ``node`` and ``executor`` exist inside of ``with``.

    Python handles Ctrl-C, so that the command can end the nodes in order.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __enter__(self) -> Self:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(self._name)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        return self

    def spin_until(self, condition: Callable[[], bool], deadline: float) -> bool:
        """Handle what arrives until a condition holds; return False at a monotonic time [s]."""
        while not condition():
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return False
            self.executor.spin_once(timeout_sec=min(remaining, _LONGEST_WAIT))
        return True

    def __exit__(self, *_: object) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()


def subscribe(
    node: Node, topic: Topic, callback: Callable[..., None], *, raw: bool = False
) -> None:
    """Subscribe to a topic; ``raw`` messages come as bytes."""
    node.create_subscription(
        message_class(topic.type_name), topic.name, callback, qos_of(topic), raw=raw
    )

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node of a command that observes a flight, spun from the main thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, Self

import rclpy
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_namespace import validate_namespace

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.messages import message_class, qos_of
from quad_mpc_ros.ros.nodes.parameter_query import ParameterQuery

_MAX_WAIT = 0.05  # s, until a condition is checked again


class Observer:
    """Base of nodes that observe a flight; ``node`` and ``executor`` exist inside ``with``.

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
        """Handle messages until a condition holds; return False at a monotonic time [s]."""
        while not condition():
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return False
            self.executor.spin_once(timeout_sec=min(remaining, _MAX_WAIT))
        return True

    def parameters(self, names: Iterable[str], deadline: float) -> dict[str, dict[str, Any]]:
        """Return the parameters, by full name, of the nodes that answer until a time [s]."""
        queries = {name: ParameterQuery(self.node, name) for name in names}
        found: dict[str, dict[str, Any]] = {}

        def all_there() -> bool:
            for name, query in queries.items():
                values = query.poll()
                if values is not None:
                    found[name] = values
            return len(found) == len(queries)

        self.spin_until(all_there, deadline)
        for query in queries.values():
            query.close()
        return found

    def __exit__(self, *_: object) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()


def checked_namespace(given: str) -> str:
    """Return a namespace without outer slashes; raises :class:`UserError` if invalid."""
    namespace = given.strip("/")
    try:
        validate_namespace(f"/{namespace}")
    except InvalidNamespaceException as error:
        raise UserError(
            f"--namespace: given {given!r}, expected a ROS namespace, for example uav1: "
            f"{' '.join(str(error).split())}"
        ) from error
    return namespace


def subscribe(
    node: Node, topic: Topic, callback: Callable[..., None], *, raw: bool = False
) -> None:
    """Subscribe to a topic; ``raw`` messages come as bytes."""
    node.create_subscription(
        message_class(topic.type_name), topic.name, callback, qos_of(topic), raw=raw
    )

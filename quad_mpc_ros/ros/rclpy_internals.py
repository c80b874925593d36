"""What rclpy keeps to itself or calls experimental, and this package needs: all of it is here.

Written for rclpy 7.1 of Jazzy. ``test/ros/test_rclpy_internals.py`` fails when another version
changes any of it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter

RCLError: Any = rclpy_implementation.RCLError
"""The error of whatever is done after a signal has shut ROS down."""


def fastest_executor(*, message_info: bool) -> Any:
    """Return rclpy's events executor, which wakes in a fifth of the time, or the plain one.

    The events executor of rclpy 7.1.6 fails on callbacks that take the message's info as well.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:  # the first releases of Jazzy
        return SingleThreadedExecutor()
    return SingleThreadedExecutor() if message_info else EventsExecutor()


def given_parameters(node: Node) -> dict[str, Any]:
    """Return the values that were given to a node by name, [] for an empty list.

    rclpy declares none of those that a node does not ask for, and none without a type: an empty
    list in a file, as ``ros2 param dump`` writes it, has none.
    """
    overrides: dict[str, Parameter] = node._parameter_overrides
    return {
        name: [] if given.type_ is Parameter.Type.NOT_SET else given.value
        for name, given in overrides.items()
    }


def lifecycle_state(node: LifecycleNode) -> str:
    """Return the label of the state that a node is in."""
    return str(node._state_machine.current_state[1])


def possible_transitions(node: LifecycleNode) -> dict[int, str]:
    """Return the transitions out of the state that a node is in: label by number."""
    return {number: label for number, label, *_ in node._state_machine.available_transitions}


def wrap_change_state(node: LifecycleNode, wrapper: Callable[[Any, Any, Any], Any]) -> None:
    """Let a wrapper serve the requests for transitions of a node.

    It gets rclpy's own callback, the request and the response, and returns the response.
    """
    service = node._service_change_state
    service.callback = functools.partial(wrapper, service.callback)

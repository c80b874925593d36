"""What is used of rclpy's insides is there and does what it is used for, in this rclpy."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.task import Future
from std_msgs.msg import Bool

from quad_mpc_ros.ros import rclpy_internals


def changed(what: str) -> str:
    version = importlib.metadata.version("rclpy")
    return f"rclpy {version} has changed {what}: mend quad_mpc_ros/ros/rclpy_internals.py"


@pytest.fixture
def node() -> Iterator[LifecycleNode]:
    rclpy.init()
    made = LifecycleNode("inspected")
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def test_what_was_given_to_a_node_is_known_by_name() -> None:
    rclpy.init(args=["--ros-args", "-p", "a:=1", "-p", "b:=[]", "-p", "c.d:=[1.5]"])
    node = LifecycleNode("inspected")
    given = rclpy_internals.given_parameters(node)
    node.destroy_node()
    rclpy.try_shutdown()
    assert (given["a"], given["b"], list(given["c.d"])) == (1, [], [1.5]), changed("overrides")


def test_the_names_are_there(node: LifecycleNode) -> None:
    assert hasattr(node, "_state_machine"), changed("LifecycleNode._state_machine")
    machine = node._state_machine
    assert machine.current_state[1] == "unconfigured", changed("LifecycleStateMachine")
    assert hasattr(machine, "available_transitions"), changed("LifecycleStateMachine")
    assert hasattr(node, "_service_change_state"), changed("LifecycleNode._service_change_state")
    assert callable(node._service_change_state.callback), changed("Service.callback")


def test_state_and_transitions_follow_the_node(node: LifecycleNode) -> None:
    assert rclpy_internals.lifecycle_state(node) == "unconfigured"
    assert set(rclpy_internals.possible_transitions(node).values()) == {"configure", "shutdown"}
    assert rclpy_internals.possible_transitions(node)[1] == "configure"
    node.trigger_configure()
    assert rclpy_internals.lifecycle_state(node) == "inactive", changed("the labels of states")
    assert "activate" in rclpy_internals.possible_transitions(node).values()


@pytest.mark.parametrize("message_info", [False, True])
def test_the_wrapper_serves_requests_under_both_executors(
    node: LifecycleNode, message_info: bool
) -> None:
    seen = []

    def wrapper(carry_out: Any, request: Any, response: Any) -> Any:
        seen.append(request.transition.label)
        return carry_out(request, response)

    rclpy_internals.wrap_change_state(node, wrapper)
    peer = rclpy.create_node("peer")
    client = peer.create_client(ChangeState, "inspected/change_state")
    executor = rclpy_internals.fastest_executor(message_info=message_info)
    assert isinstance(executor, SingleThreadedExecutor) is message_info, changed("EventsExecutor")
    executor.add_node(node)
    executor.add_node(peer)
    try:
        assert client.wait_for_service(10.0)
        # A client that has found its service may not have been found by it.
        executor.spin_until_future_complete(Future(), timeout_sec=0.3)
        request = ChangeState.Request()
        request.transition.label = "configure"
        answer = client.call_async(request)
        executor.spin_until_future_complete(answer, timeout_sec=10.0)
        assert answer.done() and answer.result().success, changed("Service.callback")
    finally:
        executor.remove_node(node)
        executor.remove_node(peer)
        peer.destroy_node()
    assert seen == ["configure"], changed("Service.callback")
    assert rclpy_internals.lifecycle_state(node) == "inactive"


def test_what_is_done_after_the_shutdown_raises_its_error(node: LifecycleNode) -> None:
    publisher = node.create_publisher(Bool, "too_late", 1)
    rclpy.shutdown()
    with pytest.raises(rclpy_internals.RCLError):
        publisher.publish(Bool())

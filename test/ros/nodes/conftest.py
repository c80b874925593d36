# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes, and a node of the test that talks with them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fixtures.peer import Peer
from fixtures.processes import end
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.messages import cdr, conversions


@contextmanager
def _node_process(
    name: str, *arguments: str, before: Sequence[str], log: Path
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node; it is ended by SIGINT at the end of the block, by force if need be."""
    module = f"quad_mpc_ros.ros.{'stack_node' if name == 'stack' else f'nodes.{name}_node'}"
    command = [sys.executable, "-m", module, *before, "--ros-args", *arguments]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
    try:
        yield process
    finally:
        end(process)


@pytest.fixture
def peer() -> Iterator[Peer]:
    made = Peer()
    yield made
    made.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Start nodes by name and ROS arguments, with others ``before`` those; they end with the test.

    Logs: tmp_path/<name>.log.
    """
    with ExitStack() as stack:

        def start_node(
            name: str, *arguments: str, before: Sequence[str] = ()
        ) -> subprocess.Popen[bytes]:
            log = tmp_path / f"{name}.log"
            process = _node_process(name, *arguments, before=before, log=log)
            return stack.enter_context(process)

        yield start_node


class Feed:
    """Odometry at rest at its reference, 50 times a second, when switched on."""

    def __init__(self, peer: Peer) -> None:
        self.odometry = self.reference = True
        self.decimation = 1  # of the odometry
        self._count = 0
        self.yaw = 0.0  # of the reference
        self.height = 2.0  # of the odometry: at the reference, where a hovering vehicle rests
        self._peer = peer
        self._odometry = peer.node.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self._reference = peer.node.create_publisher(MultiDOFJointTrajectory, "reference", 10)
        peer.node.create_timer(0.02, self.send)

    def send(self) -> None:
        """Send the enabled messages with the current time."""
        stamp_ns = int(self._peer.node.get_clock().now().nanoseconds)
        if self.reference:
            held = ReferenceWindow.hover([0.0, 0.0, 2.0], yaw=self.yaw, stamp_ns=stamp_ns)
            self._reference.publish(cdr.written_reference(held, child_frame_id="b"))
        self._count += 1
        if self.odometry and self._count % self.decimation == 0:
            odometry = Odometry()
            rest = OdometrySample.at_rest([0.0, 0.0, self.height], stamp_ns=stamp_ns)
            conversions.fill_odometry(odometry, rest)
            self._odometry.publish(odometry)


@pytest.fixture
def feed(peer: Peer) -> Feed:
    return Feed(peer)


class Managed:
    """A node with a lifecycle as its user sees it: transitions, parameters, health."""

    def __init__(self, peer: Peer, name: str) -> None:
        self._peer, self._name = peer, name
        node = peer.node
        self._change = node.create_client(ChangeState, f"{name}/change_state")
        self._get = node.create_client(GetState, f"{name}/get_state")
        self._set = node.create_client(
            SetParametersAtomically, f"{name}/set_parameters_atomically"
        )
        self.health: dict[str, str] = {}
        self.level = DiagnosticStatus.OK
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"/{self._name}":
                values = {pair.key: pair.value for pair in status.values}
                self.health, self.level = {"text": status.message, **values}, status.level

    def to(self, transition: str | int) -> bool:
        """Ask for a transition by its label or number; return whether it was carried out."""
        asked = self.ask(transition)
        assert self._peer.wait(asked.done)
        return bool(asked.result().success)

    def ask(self, transition: str | int) -> Any:
        """Ask for a transition and return the future of the answer."""
        request = ChangeState.Request()
        if isinstance(transition, str):
            request.transition.label = transition
        else:
            request.transition.id = transition
        self._peer.find(self._change)
        return self._change.call_async(request)

    @property
    def state(self) -> str:
        return str(self._peer.call(self._get, GetState.Request()).current_state.label)

    def set(self, **values: Any) -> str:
        """Set parameters, all in one; return why they were refused, or nothing."""
        request = SetParametersAtomically.Request()
        request.parameters = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        result = self._peer.call(self._set, request).result
        return "" if result.successful else str(result.reason)

    def reports(self, state: str, text: str = "") -> bool:
        """Wait until ``/diagnostics`` shows a state and a text."""
        return self._peer.wait(
            lambda: self.health.get("state") == state and text in self.health["text"]
        )


@pytest.fixture
def managed(peer: Peer) -> Callable[[str], Managed]:
    return lambda name: Managed(peer, name)

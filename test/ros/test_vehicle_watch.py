# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that were given different vehicles say so, in the log once and in their health."""

from __future__ import annotations

import time
from pathlib import Path
from unittest.mock import Mock

import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from fixtures.ros_context import initialised  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402

from quad_mpc_ros.messages.diagnostics import WARN  # noqa: E402
from quad_mpc_ros.ros.bridges.node import BridgeNode  # noqa: E402
from quad_mpc_ros.ros.bridges.rates import RatesBridge  # noqa: E402
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode  # noqa: E402
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode  # noqa: E402

VEHICLE = """
/**:
  ros__parameters:
    mass: 0.5
    thrust_curve: [2.0, 3.0, 0.0]
    rate_time_constant: [0.05, 0.05, 0.1]
    thrust_map: {kind: linear, full_thrust: 20.0}
"""


def test_another_mass_is_reported_once_and_in_the_health(tmp_path: Path) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text(VEHICLE + "/**/reference: {ros__parameters: {mass: 0.75}}\n")
    with initialised(["test", "--ros-args", "--params-file", str(file)]):
        mpc, reference, listener = MpcNode(), ReferenceNode(), Node("listener")
        logger = Mock()
        mpc.get_logger = lambda: logger
        reference.begin()
        nodes = [mpc, reference, BridgeNode(RatesBridge), listener]
        received: list[DiagnosticArray] = []
        listener.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
        executor = SingleThreadedExecutor()
        for node in nodes:
            executor.add_node(node)
        end = time.monotonic() + 6.0
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
        for node in nodes:
            node.destroy_node()
    warnings = [call.args[0] for call in logger.warning.call_args_list]
    health = [each for message in received for each in message.status if each.name == "/mpc"]
    (warning,) = [text for text in warnings if "vehicle" in text]
    expected = (
        "mpc and reference have different vehicle parameters: mass 0.5 of mpc, 0.75 of reference"
    )
    assert warning == f"{expected}; give every node the same vehicle file"
    assert health[-1].level == WARN
    assert health[-1].message.startswith(expected)

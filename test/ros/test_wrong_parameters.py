# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A running node refuses every wrong value of every parameter, and says why."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator

import pytest
from fixtures.ros_context import initialised
from fixtures.wrong_inputs import wrong_values
from rclpy.node import Node
from rclpy.parameter import Parameter

from quad_mpc_ros.commands.params import own_nodes
from quad_mpc_ros.configuration import Configuration
from quad_mpc_ros.ros.bridges.node import BridgeNode
from quad_mpc_ros.ros.bridges.rates import RatesBridge
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.nodes.recorder_node import RecorderNode
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode
from quad_mpc_ros.ros.nodes.simulator_node import SimulatorNode
from quad_mpc_ros.ros.nodes.visualisation_node import VisualisationNode

KINDS: dict[str, type[Configuration]] = {**own_nodes(), "rates_bridge": RatesBridge.Config}
NODES: dict[str, Callable[[], Node]] = {
    "mpc": MpcNode,
    "reference": ReferenceNode,
    "recorder": RecorderNode,
    "simulator": SimulatorNode,
    "visualisation": VisualisationNode,
    "rates_bridge": lambda: BridgeNode(RatesBridge),
}
WRONG = {
    node: [(spec.name, value) for spec in KINDS[node].specs() for _, value in wrong_values(spec)]
    for node in NODES
}
COUNTED = {f"{node}: {len(wrong)} values": node for node, wrong in WRONG.items()}


@pytest.fixture(autouse=True, scope="module")
def no_node_is_left() -> Iterator[None]:
    yield
    gc.collect()


@pytest.mark.parametrize("counted", COUNTED)
def test_every_wrong_value_is_refused_with_a_reason(counted: str) -> None:
    name = COUNTED[counted]
    autostart = ["-p", "autostart:=false"] if "autostart" in dir(KINDS[name]) else []
    with initialised(["--ros-args", *autostart]):
        node = NODES[name]()
        for parameter, value in WRONG[name]:
            before = node.get_parameter(parameter).value
            (result,) = node.set_parameters([Parameter(parameter, value=value)])
            assert not result.successful, (parameter, value)
            assert result.reason, (parameter, value)
            assert node.get_parameter(parameter).value == before
        node.destroy_node()

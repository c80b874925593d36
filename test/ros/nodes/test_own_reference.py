# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A node declares the parameters of what another package has registered."""

from __future__ import annotations

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.ros.parameters import ManagedParameters


@pytest.mark.usefixtures("own_package")
def test_other_package_trajectory_declares_its_parameters() -> None:
    rclpy.init()
    node = Node(
        "reference",
        parameter_overrides=[
            Parameter("trajectory", value="swing"),
            Parameter("swing_width", value=2),
        ],
    )
    try:
        parameters = ManagedParameters(node, ReferenceConfig, apply=lambda _: None)
        assert node.get_parameter("swing_width").value == 2.0
        assert "swing: angular frequency" in node.describe_parameter("swing_rate").description
        node.set_parameters([Parameter("swing_rate", value=1)])
        config = parameters.finalize()
        assert config.flattened()["swing_rate"] == 1.0
    finally:
        node.destroy_node()
        rclpy.shutdown()

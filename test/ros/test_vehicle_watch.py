# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that were given different vehicles say so, in the log once and in their health."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402

from quad_mpc_ros.messages.diagnostics import WARN  # noqa: E402
from quad_mpc_ros.ros.bridges.node import BridgeNode  # noqa: E402
from quad_mpc_ros.ros.bridges.rates import RatesBridge  # noqa: E402
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode  # noqa: E402
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode  # noqa: E402

Fly = Callable[[str], tuple[list[str], list[tuple[bytes, str]]]]

VEHICLE = """
/**:
  ros__parameters:
    mass: 0.5
    thrust_curve: [2.0, 3.0, 0.0]
    rate_time_constant: [0.05, 0.05, 0.1]
    thrust_map: {kind: linear, full_thrust: 20.0}
"""
ANOTHER = VEHICLE + "/**/reference: {ros__parameters: {mass: 0.75}}\n"


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Fly]:
    """Return what starts mpc, reference and bridge with a file: warnings, the mpc's health."""

    def start(text: str) -> tuple[list[str], list[tuple[bytes, str]]]:
        file = tmp_path / "vehicle.yaml"
        file.write_text(text)
        rclpy.init(args=["test", "--ros-args", "--params-file", str(file)])
        warnings: list[str] = []
        health: list[tuple[bytes, str]] = []
        mpc = MpcNode()
        logger = mpc.get_logger()
        mpc.get_logger = lambda: _Kept(logger, warnings)
        reference = ReferenceNode()
        reference.begin()
        nodes = [mpc, reference, BridgeNode(RatesBridge), Node("listener")]
        nodes[-1].create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda message: health.extend(
                (status.level, status.message)
                for status in message.status
                if status.name == "/mpc"
            ),
            10,
        )
        executor = SingleThreadedExecutor()
        for node in nodes:
            executor.add_node(node)
        end = time.monotonic() + 6.0
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
        for node in nodes:
            node.destroy_node()
        return warnings, health

    yield start
    rclpy.try_shutdown()


class _Kept:
    """A logger that remembers warnings."""

    def __init__(self, logger: object, warnings: list[str]) -> None:
        self._logger, self._warnings = logger, warnings

    def warning(self, text: str, **_: object) -> None:
        self._warnings.append(text)

    def __getattr__(self, name: str) -> object:
        return getattr(self._logger, name)


def test_another_mass_is_reported_once_and_in_the_health(started: Fly) -> None:
    warnings, health = started(ANOTHER)
    (warning,) = [text for text in warnings if "vehicle" in text]
    expected = (
        "mpc and reference have different vehicle parameters: mass 0.5 of mpc, 0.75 of reference"
    )
    assert warning == f"{expected}; give every node the same vehicle file"
    level, text = health[-1]
    assert level == WARN
    assert text.startswith(expected)

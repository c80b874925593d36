# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""MPC, reference and a bridge as nodes of one process."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.processes import PATIENCE
from fixtures.setup_py import write_metadata
from geometry_msgs.msg import TwistStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import Trigger

from quad_mpc_ros.ros.stack_node import main

Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture
def registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let processes find a bridge where the package is not installed, too."""
    entries = ["rates_bridge = quad_mpc_ros.ros.bridges.rates:RatesBridge"]
    write_metadata(tmp_path, "a_stack", {"quad_mpc_ros.bridges": entries})
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)


def test_planning_does_not_delay_the_mpc(start: Start, peer: Any, feed: Any) -> None:
    """Requests are planned in the reference's thread while the MPC answers each odometry."""
    feed.reference = False
    commands: list[TwistStamped] = []
    peer.node.create_subscription(
        TwistStamped, "command", commands.append, qos_profile_sensor_data
    )
    start("stack", "-p", "reference:mode:=on_request", "-p", "reference:trajectory:=minimum_snap")
    takeoff = peer.node.create_client(Trigger, "reference/takeoff")

    response = peer.call(takeoff, Trigger.Request())

    assert response.success, response.message
    assert peer.wait(lambda: len(commands) > 50)


@pytest.mark.usefixtures("registered")
def test_runs_a_bridge_and_ends_with_the_shutdown_of_one_node(
    start: Start, peer: Any, managed: Any
) -> None:
    nodes = [managed(name) for name in ("mpc", "reference", "rates_bridge")]
    process = start("stack", before=("--bridge", "rates"))
    assert peer.wait(lambda: all(node.health for node in nodes))

    client = peer.node.create_client(ChangeState, "/reference/change_state")
    request = ChangeState.Request()
    request.transition = Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN)

    assert peer.call(client, request).success

    assert process.wait(PATIENCE) == 0


def test_a_wrong_parameter_is_one_line(start: Start, tmp_path: Path) -> None:
    assert start("stack", "-p", "reference:side:=-1.0").wait(PATIENCE) == 2
    log = (tmp_path / "stack.log").read_text()
    assert "error: reference.side: given -1.0, expected a number > 0" in log
    assert "Traceback" not in log


def test_an_unknown_bridge_is_one_line(
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert main(["stack_node", "--bridge", "kite"]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("error: --bridge: given 'kite', expected one of")

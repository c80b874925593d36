"""MPC, reference and a bridge as nodes of one process."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.processes import PATIENCE
from fixtures.setup_py import write_metadata
from geometry_msgs.msg import TwistStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture
def registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let processes find a bridge where the package is not installed, too."""
    entries = ["rates_bridge = quad_mpc_ros.ros.bridges.rates:RatesBridge"]
    write_metadata(tmp_path, "a_stack", {"quad_mpc_ros.bridges": entries})
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)


def peers_of(diagnostics: list[DiagnosticArray], node: str) -> dict[str, str]:
    """Return the last diagnostics of a node."""
    found: dict[str, str] = {}
    for message in diagnostics:
        for status in message.status:
            if status.name == node:
                found = {pair.key: pair.value for pair in status.values}
    return found


def test_windows_reach_the_mpc_without_dds(start: Start, peer: Any, feed: Any) -> None:
    """The MPC answers odometry without a publisher of references."""
    commands: list[TwistStamped] = []
    diagnostics: list[DiagnosticArray] = []
    peer.node.create_subscription(
        TwistStamped, "command", commands.append, qos_profile_sensor_data
    )
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", diagnostics.append, 10)
    feed.reference = False

    start("stack", "-p", "reference:trajectory:=hover")

    assert peer.wait(lambda: len(commands) > 50)  # the first one compiles
    assert peer.wait(lambda: "engaged" in peers_of(diagnostics, "/mpc"))
    assert "peers.odom" in peers_of(diagnostics, "/mpc")
    assert "peers.reference" not in peers_of(diagnostics, "/mpc")
    assert peers_of(diagnostics, "/reference")["mode"]
    assert peer.node.count_subscribers("reference") == 0


def test_windows_are_published_as_well(start: Start, peer: Any, feed: Any) -> None:
    feed.reference = False
    windows: list[MultiDOFJointTrajectory] = []
    peer.node.create_subscription(MultiDOFJointTrajectory, "reference", windows.append, 10)

    start("stack", "-r", "__ns:=/")

    assert peer.wait(lambda: len(windows) > 3)


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


@pytest.mark.parametrize("node", ["mpc", "reference"])
def test_the_shutdown_of_one_node_ends_all(node: str, start: Start, peer: Any) -> None:
    process = start("stack")
    client = peer.node.create_client(ChangeState, f"/{node}/change_state")
    request = ChangeState.Request()
    request.transition = Transition(id=Transition.TRANSITION_INACTIVE_SHUTDOWN)
    if node == "reference":
        request.transition = Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN)

    assert peer.call(client, request).success

    assert process.wait(PATIENCE) == 0


def test_a_wrong_parameter_is_one_line(start: Start, tmp_path: Path) -> None:
    assert start("stack", "-p", "reference:side:=-1.0").wait(PATIENCE) == 2
    log = (tmp_path / "stack.log").read_text()
    assert "error: reference.side: given -1.0, expected a number > 0" in log
    assert "Traceback" not in log


@pytest.mark.usefixtures("registered")
def test_a_bridge_is_a_node_of_the_same_process(start: Start, peer: Any) -> None:
    diagnostics: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", diagnostics.append, 10)
    start("stack", before=("--bridge", "rates"))
    for node in ("/mpc", "/reference", "/rates_bridge"):
        assert peer.wait(lambda node=node: peers_of(diagnostics, node)), node


@pytest.mark.usefixtures("registered")
def test_an_unknown_bridge_is_one_line(start: Start, tmp_path: Path) -> None:
    assert start("stack", before=("--bridge", "kite")).wait(PATIENCE) == 2
    log = (tmp_path / "stack.log").read_text()
    assert "error: --bridge: given 'kite', expected one of" in log
    assert "rates_bridge" in log
    assert "Traceback" not in log

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The serial port, at a pseudo-terminal, and the node that has one."""

from __future__ import annotations

import contextlib
import os
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from fixtures.betaflight import msp_telemetry, requests, set_raw_rc
from fixtures.bridges import HOVER
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from quad_mpc_ros.extras.bridges.betaflight import BetaflightBridge
from quad_mpc_ros.ros.bridges import line as line_module
from quad_mpc_ros.ros.bridges import node as node_module
from quad_mpc_ros.ros.bridges.line import SerialLine

pytest.importorskip("serial")


class Terminal:
    """A pseudo-terminal under a name that stays when the device behind it changes."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "tty"
        self.end = -1

    def plug(self) -> None:
        self.end, device = os.openpty()
        tty.setraw(device)
        os.set_blocking(self.end, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(device))
        self._device = device

    def unplug(self) -> None:
        os.close(self.end)
        os.close(self._device)
        self.path.unlink()
        self.end = -1

    def read(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self.end, 65536)
        return b""


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    made = Terminal(tmp_path)
    made.plug()
    yield made
    if made.end >= 0:
        made.unplug()


def eventually(what: Callable[[], object], timeout: float = 10.0) -> None:
    deadline = time.monotonic() + timeout
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_bytes_pass_unchanged_in_both_directions(terminal: Terminal) -> None:
    line = SerialLine(str(terminal.path), 115200)
    every = bytes(range(256))
    assert line.read() == b""
    line.write(every)
    os.write(terminal.end, every)
    found = {"there": b"", "here": b""}

    def come() -> bool:
        found["there"] += terminal.read()
        found["here"] += line.read()
        return found["there"] == found["here"] == every

    eventually(come)
    line.close()


def test_reports_and_reopens_lost_port(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_module, "RECONNECT_PERIOD", 0.0)
    line = SerialLine(str(terminal.path), 115200)
    line.read()
    assert not line.fault
    terminal.unplug()
    eventually(lambda: [line.write(b"x"), line.read(), line.fault][-1])
    assert str(terminal.path) in line.fault
    terminal.plug()
    eventually(lambda: [line.read(), not line.fault][-1])
    os.write(terminal.end, b"back")
    found = []
    eventually(lambda: [found.append(line.read()), b"".join(found) == b"back"][-1])
    line.close()


def test_missing_port_does_not_end_the_node(tmp_path: Path) -> None:
    line = SerialLine(str(tmp_path / "none"), 115200)
    assert line.read() == b""
    line.write(b"x")
    assert "none" in line.fault


def test_node_requests_receives_and_sends_over_its_port(terminal: Terminal) -> None:
    """With a flight controller at the other end that is armed and gives away its sticks."""
    rclpy.init(args=["--ros-args", "-p", f"device:={terminal.path}"])
    node = node_module.BridgeNode(BetaflightBridge)
    peer = rclpy.create_node("peer", parameter_overrides=[Parameter("use_sim_time", value=False)])
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(peer)
    odometry = peer.create_publisher(Odometry, "stack_odom", rclpy.qos.qos_profile_sensor_data)
    command = peer.create_publisher(TwistStamped, "command", rclpy.qos.qos_profile_sensor_data)
    asked: set[int] = set()
    sticks: list[tuple[int, ...]] = []
    held = b""
    deadline = time.monotonic() + 20.0
    try:
        while not (sticks and sticks[-1][1] > 1500):
            assert time.monotonic() < deadline, (node.report(), asked, sticks[-3:])
            executor.spin_once(timeout_sec=0.01)
            held += terminal.read()
            whole = held.rfind(b"$M<")
            if whole > 0:
                asked |= {number for number, _ in requests(held[:whole])}
                sticks += set_raw_rc(held[:whole])
                held = held[whole:]
                os.write(terminal.end, msp_telemetry())
            now = peer.get_clock().now().to_msg()
            seen, wanted = Odometry(), TwistStamped()
            seen.header.frame_id, seen.pose.pose.orientation.w = "world", 1.0
            seen.header.stamp = wanted.header.stamp = now
            wanted.twist.linear.z, wanted.twist.angular.y = HOVER, 0.5
            odometry.publish(seen)
            command.publish(wanted)
            if node.report().values and sticks:
                bridge = node._bridge
                if bridge.handover[0] == "released":
                    bridge.engage(True, now_ns=peer.get_clock().now().nanoseconds)
        assert asked >= {101, 108, 119, 111, 200}
    finally:
        node.destroy_node()
        peer.destroy_node()
        rclpy.shutdown()

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A bridge sends no setpoints after the MPC is killed or hangs in flight."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.peer import Peer
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import SetBool

from quad_mpc_ros.messages import conversions

Process = subprocess.Popen[bytes]

SECOND = 1_000_000_000
SILENT_AFTER_NS = SECOND // 10

# The simulator plays the stack: it says where it is on a topic of its own, and acts on setpoints.
NODES: dict[str, tuple[str, ...]] = {
    "simulator_node": ("-r", "odom:=stack_odom", "-r", "command:=rates_setpoint"),
    "reference_node": ("-p", "trajectory:=hover", "-p", "height:=1.0"),
    "rates_bridge": (),
    "mpc_node": (),
}


class Listener(Peer):
    """A node that receives the stack's setpoints and the bridge's diagnostics."""

    def __init__(self) -> None:
        super().__init__()
        self.sent_ns: list[int] = []
        self.height = 0.0
        self.health: dict[str, str] = {}
        make = self.node.create_subscription
        make(TwistStamped, "rates_setpoint", self.on_setpoint, 100)
        make(Odometry, "stack_odom", self.on_odometry, qos_profile_sensor_data)
        make(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)
        self.engage = self.node.create_client(SetBool, "rates_bridge/engage")

    def on_setpoint(self, message: Any) -> None:
        # The bridge stamps a setpoint with the time at which it sends it.
        self.sent_ns.append(conversions.nanoseconds(message.header.stamp))

    def on_odometry(self, message: Any) -> None:
        self.height = message.pose.pose.position.z

    def on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if status.name.endswith("rates_bridge"):
                self.health = {pair.key: pair.value for pair in status.values}
                self.health["text"] = status.message

    def take_over(self) -> None:
        """Ask the bridge to engage until the MPC commands and the bridge accepts."""

        def accepted() -> bool:
            return bool(self.call(self.engage, SetBool.Request(data=True)).success)

        assert self.wait(accepted)


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener()
    yield made
    made.close()


@pytest.fixture
def processes(start: Callable[..., Process]) -> dict[str, Process]:
    return {name: start(name, *arguments) for name, arguments in NODES.items()}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_stack_receives_no_setpoints_from_killed_or_hanging_controller(
    number: int, listener: Listener, processes: dict[str, Process]
) -> None:
    listener.take_over()
    assert listener.wait(lambda: listener.height > 0.5), "it does not fly"
    assert listener.wait(lambda: listener.health.get("engaged") == "true")
    before = len(listener.sent_ns)
    assert listener.wait(lambda: len(listener.sent_ns) >= before + 10)

    signalled_ns = time.time_ns()
    os.kill(processes["mpc_node"].pid, number)
    listener.spin(0.7)

    assert listener.sent_ns[-1] - signalled_ns <= SILENT_AFTER_NS
    # It was flying until then, and the bridge has not gone with it.
    assert signalled_ns - listener.sent_ns[-1] <= SECOND // 2
    assert listener.wait(lambda: listener.health["text"] == "silent: no commands from the mpc")
    assert processes["rates_bridge"].poll() is None
    if number == signal.SIGSTOP:
        count = len(listener.sent_ns)
        processes["mpc_node"].send_signal(signal.SIGCONT)
        # Its commands have no effect until the bridge is engaged again.
        assert listener.wait(lambda: "engage" in listener.health["text"])
        listener.spin(1.0)
        assert len(listener.sent_ns) == count
        assert listener.health["handover"] == "released"
        listener.take_over()
        assert listener.wait(lambda: len(listener.sent_ns) > count + 10), "it does not fly again"

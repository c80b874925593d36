"""A bridge sends no setpoints after the MPC is killed or hangs in flight."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
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


# s: the first start after an installation compiles.
_PATIENCE = 90.0


class Listener:
    """A node that receives the stack's setpoints and the bridge's diagnostics."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("test_listener")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.sent_ns: list[int] = []
        self.height = 0.0
        self.health: dict[str, str] = {}
        make = self.node.create_subscription
        make(TwistStamped, "rates_setpoint", self.on_setpoint, 100)
        make(Odometry, "stack_odom", self.on_odometry, qos_profile_sensor_data)
        make(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)
        self.engage = self.node.create_client(SetBool, "rates_bridge/engage")

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.shutdown()

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

    def spin(self, until: Callable[[], object], timeout: float = _PATIENCE) -> bool:
        deadline = time.monotonic() + timeout
        while not until():
            if time.monotonic() > deadline:
                return False
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def take_over(self, *, matching: float) -> None:
        """Ask the bridge to engage until the MPC commands and it does."""
        assert self.spin(self.engage.service_is_ready)
        self.spin(lambda: False, timeout=matching)
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline:
            future = self.engage.call_async(SetBool.Request(data=True))
            assert self.spin(future.done)
            if future.result().success:
                return
            self.spin(lambda: False, timeout=0.2)
        raise AssertionError(future.result().message)


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener()
    yield made
    made.close()


@pytest.fixture
def processes(start: Callable[..., Process]) -> dict[str, Process]:
    return {name: start(name, *arguments) for name, arguments in NODES.items()}


@pytest.mark.timeout(3 * _PATIENCE)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_stack_gets_nothing_from_killed_or_hanging_controller(
    number: int, listener: Listener, processes: dict[str, Process], matching: float
) -> None:
    listener.take_over(matching=matching)
    assert listener.spin(lambda: listener.height > 0.5), "it does not fly"
    assert listener.spin(lambda: listener.health.get("engaged") == "true")
    before = len(listener.sent_ns)
    assert listener.spin(lambda: len(listener.sent_ns) >= before + 10)

    signalled_ns = time.time_ns()
    os.kill(processes["mpc_node"].pid, number)
    listener.spin(lambda: False, timeout=0.7)

    assert listener.sent_ns[-1] - signalled_ns <= SILENT_AFTER_NS
    # It was flying until then, and the bridge has not gone with it.
    assert signalled_ns - listener.sent_ns[-1] <= SECOND // 2
    assert listener.spin(lambda: listener.health["text"] == "silent: no commands from the mpc")
    assert processes["rates_bridge"].poll() is None
    if number == signal.SIGSTOP:
        count = len(listener.sent_ns)
        processes["mpc_node"].send_signal(signal.SIGCONT)
        # Its commands have no effect until the bridge is engaged again.
        assert listener.spin(lambda: "engage" in listener.health["text"])
        listener.spin(lambda: False, timeout=1.0)
        assert len(listener.sent_ns) == count
        assert listener.health["handover"] == "released"
        listener.take_over(matching=matching)
        assert listener.spin(lambda: len(listener.sent_ns) > count + 10), "it does not fly again"

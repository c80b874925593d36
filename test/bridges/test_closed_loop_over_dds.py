"""The square through the rates bridge, whose messages are installed: every part a process.

Time stands still until a command has come, so that the flight is that of a machine in time.
"""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import SetBool, Trigger

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.core.vehicle import Vehicle
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.ros import conversions
from quad_mpc_ros.simulation.closed_loop import SIMULATION_START_NS, fly
from quad_mpc_ros.simulation.config import SimulatorConfig

Process = subprocess.Popen[bytes]

DURATION = 8.0
VEHICLE = Vehicle()
TIMEOUT_NS = 100_000_000
SIMULATED_TIME = ("-p", "use_sim_time:=true")
NODES: dict[str, tuple[str, ...]] = {
    "nodes.simulator_node": (
        *("-r", "odom:=truth", "-r", "command:=motors"),
        *("-p", "lockstep:=true", "-p", "autostart:=false", "-p", f"duration:={DURATION}"),
    ),
    "nodes.reference_node": (*SIMULATED_TIME, "-p", "lockstep:=true"),
    "nodes.mpc_node": (*SIMULATED_TIME, "-p", "lockstep:=true"),
    "bridges.rates_bridge": (
        *(*SIMULATED_TIME, "-p", "thrust_unit:=newton"),
        *("-p", "body_frame:=frd", "-p", "angle_unit:=deg"),
    ),
}


class FakeStack:
    """Takes newton along z down and degrees a second about FRD axes, and not for long nothing."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("fake_stack")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        make, sensor = self.node.create_publisher, qos_profile_sensor_data
        self._state = make(Odometry, "stack_odom", sensor)
        self._motors = make(TwistStamped, "motors", sensor)
        self.node.create_subscription(Odometry, "truth", self._on_truth, sensor)
        self.node.create_subscription(TwistStamped, "rates_setpoint", self._on_setpoint, 10)
        self.flown: dict[int, Array] = {}
        self._stamp: Any = None
        self._answered_ns: int | None = None

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.shutdown()

    def spin(self, until: Callable[[], object], timeout: float = 60.0) -> bool:
        deadline = time.monotonic() + timeout
        while not until():
            if time.monotonic() > deadline:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def call(self, kind: Any, service: str, request: Any) -> Any:
        client = self.node.create_client(kind, service)
        assert self.spin(client.service_is_ready), service
        future = client.call_async(request)
        assert self.spin(future.done), service
        return future.result()

    def hears_everybody(self) -> bool:
        """Return whether the bridge and the simulator are matched, and the MPC with both."""
        topics = ("stack_odom", "motors", "command", "odom", "reference")
        return all(
            self.node.count_publishers(topic) and self.node.count_subscribers(topic)
            for topic in topics
        )

    def _on_truth(self, message: Odometry) -> None:
        now_ns, position = (
            conversions.nanoseconds(message.header.stamp),
            message.pose.pose.position,
        )
        if self._answered_ns is not None:
            assert now_ns - self._answered_ns <= TIMEOUT_NS, "setpoints timed out"
        self.flown[now_ns] = np.array([position.x, position.y, position.z])
        self._stamp = message.header.stamp
        self._state.publish(message)

    def _on_setpoint(self, message: TwistStamped) -> None:
        if self._stamp is None:
            return
        newton, w = -message.twist.linear.z, message.twist.angular
        lowest, highest = VEHICLE.thrust(0.0), VEHICLE.thrust(1.0)
        assert lowest <= newton <= highest
        command = TwistStamped()
        command.header.stamp = self._stamp
        command.twist.linear.z = VEHICLE.throttle_for(newton)
        command.twist.angular.x = math.radians(w.x)
        command.twist.angular.y = -math.radians(w.y)
        command.twist.angular.z = -math.radians(w.z)
        self._answered_ns = conversions.nanoseconds(self._stamp)
        self._motors.publish(command)


@pytest.fixture
def stack() -> Iterator[FakeStack]:
    made = FakeStack()
    yield made
    made.close()


@pytest.fixture
def processes(start: Callable[..., Process]) -> dict[str, Process]:
    return {module: start(module, *arguments) for module, arguments in NODES.items()}


def rmse(flown: dict[int, Array]) -> float:
    square = ReferenceServer(ReferenceConfig())
    square.start(SIMULATION_START_NS)
    errors = [square.window(stamp_ns).p_WB[0] - p_WB for stamp_ns, p_WB in flown.items()]
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


@pytest.mark.timeout(240)
def test_a_stack_of_other_units_flies_the_square_as_well_as_without_a_bridge(
    stack: FakeStack, processes: dict[str, Process]
) -> None:
    assert stack.spin(stack.hears_everybody, timeout=120.0)
    assert stack.call(SetBool, "rates_bridge/engage", SetBool.Request(data=True)).success
    assert stack.call(Trigger, "simulator/start", Trigger.Request()).success
    assert stack.spin(lambda: processes["nodes.simulator_node"].poll() is not None)
    assert processes["nodes.simulator_node"].returncode == 0

    simulator = SimulatorConfig(duration=DURATION)
    plain = fly(mpc=MpcConfig(), simulator=simulator, reference=ReferenceConfig())
    directly = {step.truth.stamp_ns: step.truth.p_WB for step in plain}
    assert stack.flown.keys() == directly.keys()
    assert rmse(stack.flown) <= 1.05 * rmse(directly)

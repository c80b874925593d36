"""Fly the square through the rates bridge over DDS, with every node as a process.

The flight is in real time. Errors are relative to the reference that the MPC received, in the last
lap, because the start of the reference depends on discovery.
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
from fixtures.presets import ideal
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS

Process = subprocess.Popen[bytes]

# More than a lap for discovery and engaging, and the lap that is measured.
DURATION = 20.0
LAP_NS = 8_000_000_000
VEHICLE = Vehicle()
TIMEOUT_NS = 500_000_000
NODES: dict[str, tuple[str, ...]] = {
    "simulator_node": (
        *("-r", "odom:=truth", "-r", "command:=motors"),
        *("-p", "autostart:=false", "-p", f"duration:={DURATION}"),
    ),
    "reference_node": (),
    "mpc_node": (),
    "rates_bridge": (
        *("-p", "thrust_unit:=newton", "-p", "body_frame:=frd", "-p", "angle_unit:=deg"),
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
        self.node.create_subscription(MultiDOFJointTrajectory, "reference", self._on_reference, 10)
        self.errors: dict[int, float] = {}  # [m] by stamp
        self._wanted: Array | None = None
        self._received_ns: int | None = None

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

    def call(self, kind: Any, service: str, request: Any, *, matching: float) -> Any:
        client = self.node.create_client(kind, service)
        assert self.spin(client.service_is_ready), service
        self.spin(lambda: False, timeout=matching)
        future = client.call_async(request)
        assert self.spin(future.done), service
        return future.result()

    def is_connected(self) -> bool:
        """Return whether each topic has its publishers and subscribers."""
        topics = ("stack_odom", "motors", "command", "odom", "reference")
        return all(
            self.node.count_publishers(topic) and self.node.count_subscribers(topic)
            for topic in topics
        )

    def _on_truth(self, message: Odometry) -> None:
        stamp_ns = conversions.nanoseconds(message.header.stamp)
        position = message.pose.pose.position
        if self._received_ns is not None:
            assert stamp_ns - self._received_ns <= TIMEOUT_NS, "setpoints timed out"
        if self._wanted is not None:
            p_WB = np.array([position.x, position.y, position.z])
            self.errors[stamp_ns] = float(np.linalg.norm(self._wanted - p_WB))
        self._state.publish(message)

    def _on_reference(self, message: MultiDOFJointTrajectory) -> None:
        self._wanted = conversions.reference_from_message(message).p_WB[0]

    def _on_setpoint(self, message: TwistStamped) -> None:
        self._received_ns = conversions.nanoseconds(message.header.stamp)
        newton, w = -message.twist.linear.z, message.twist.angular
        lowest, highest = VEHICLE.thrust(0.0), VEHICLE.thrust(1.0)
        assert lowest <= newton <= highest
        command = TwistStamped()
        command.header.stamp = message.header.stamp
        command.twist.linear.z = VEHICLE.throttle_for(newton)
        command.twist.angular.x = math.radians(w.x)
        command.twist.angular.y = -math.radians(w.y)
        command.twist.angular.z = -math.radians(w.z)
        self._motors.publish(command)


@pytest.fixture
def stack() -> Iterator[FakeStack]:
    made = FakeStack()
    yield made
    made.close()


@pytest.fixture
def processes(start: Callable[..., Process]) -> dict[str, Process]:
    return {name: start(name, *arguments) for name, arguments in NODES.items()}


def last_lap(errors: dict[int, float]) -> float:
    """Return the root mean square of the errors [m] in the last 8 s."""
    lap = [error for stamp_ns, error in errors.items() if stamp_ns > max(errors) - LAP_NS]
    assert len(lap) > 0.95 * 50 * 8
    return float(np.sqrt(np.mean(np.square(lap))))


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_a_stack_of_other_units_flies_the_square_as_well_as_without_a_bridge(
    stack: FakeStack, processes: dict[str, Process], matching: float
) -> None:
    assert stack.spin(stack.is_connected, timeout=120.0)
    assert stack.call(Trigger, "simulator/start", Trigger.Request(), matching=matching).success
    engage, refusals = SetBool.Request(data=True), []
    while not (answer := stack.call(SetBool, "rates_bridge/engage", engage, matching=0.0)).success:
        refusals.append(answer.message)
        assert len(refusals) < 100, refusals[-1]
        stack.spin(lambda: False, timeout=0.05)
    assert stack.spin(lambda: processes["simulator_node"].poll() is not None)
    assert processes["simulator_node"].returncode == 0

    simulator = ideal(duration=DURATION)
    plain = fly(mpc=MpcConfig(), simulator=simulator, reference=ReferenceConfig())
    square = ReferenceServer(ReferenceConfig())
    square.start(SIMULATION_START_NS)
    directly = {
        step.truth.stamp_ns: float(
            np.linalg.norm(square.window(step.truth.stamp_ns).p_WB[0] - step.truth.p_WB)
        )
        for step in plain
    }
    assert last_lap(stack.errors) <= 1.05 * last_lap(directly)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A bridge as a node, over DDS."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from fixtures import mavlink
from fixtures.bridges import HOVER
from fixtures.peer import Peer
from fixtures.processes import PATIENCE
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import SetBool

from quad_mpc_ros.extras.bridges.rosflight import RosflightBridge
from quad_mpc_ros.ros.bridges import node as node_module
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.mavlink import MavlinkBridge
from quad_mpc_ros.ros.bridges.node import run_bridge
from quad_mpc_ros.ros.bridges.rates import RatesBridge
from quad_mpc_ros.ros.vehicle_watch import VEHICLE_KEY


def test_a_missing_message_package_is_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    class KiteBridge(RatesBridge):
        name = "kite_bridge"
        packages = ("kite_msgs",)
        how_to_get = "ask the wind"

    assert run_bridge(KiteBridge, []) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line == (
        "error: kite_bridge: the message package kite_msgs is not installed: ask the wind"
    )


Start = Callable[..., "subprocess.Popen[bytes]"]


class StackPeer(Peer):
    """A node that plays the stack and the MPC."""

    def __init__(self) -> None:
        super().__init__()
        self.odometries: list[Odometry] = []
        self.setpoints: list[TwistStamped] = []
        self.node.create_subscription(
            Odometry, "odom", self.odometries.append, qos_profile_sensor_data
        )
        self.node.create_subscription(TwistStamped, "rates_setpoint", self.setpoints.append, 1)
        self.command = self.node.create_publisher(TwistStamped, "command", qos_profile_sensor_data)
        self.state = self.node.create_publisher(Odometry, "stack_odom", qos_profile_sensor_data)
        self.engage = self.node.create_client(SetBool, "rates_bridge/engage")
        self._asked: Any = None

    def fly(self, until: Callable[[], object]) -> bool:
        """Publish odometry and commands until something is true."""

        def published() -> object:
            odometry, command = Odometry(), TwistStamped()
            odometry.header.frame_id, odometry.pose.pose.orientation.w = "world", 1.0
            odometry.header.stamp = self.node.get_clock().now().to_msg()
            command.header.stamp = odometry.header.stamp
            command.twist.linear.z, command.twist.angular.y = HOVER, 0.5
            self.state.publish(odometry)
            self.command.publish(command)
            return until()

        return self.wait(published)

    def asked_to_engage(self) -> bool:
        """Ask the bridge to engage, if it can be asked; return whether it has accepted."""
        if self._asked is not None and self._asked.done():
            if self._asked.result().success:
                return True
            self._asked = None
        if self._asked is None and self.engage.service_is_ready():
            self._asked = self.engage.call_async(SetBool.Request(data=True))
        return False


@pytest.fixture
def peer() -> Iterator[StackPeer]:
    made = StackPeer()
    yield made
    made.close()


def test_passes_odometry_always_and_commands_when_engaged(
    start: Start, peer: StackPeer, tmp_path: Path
) -> None:
    units = ("-p", "body_frame:=frd", "-p", "angle_unit:=deg")
    process = start("rates_bridge", *units)
    assert peer.fly(lambda: len(peer.odometries) > 10)
    assert {odometry.header.frame_id for odometry in peer.odometries} == {"odom"}
    assert peer.setpoints == []

    assert peer.fly(lambda: peer.asked_to_engage())
    assert peer.fly(lambda: len(peer.setpoints) > 10)
    twist = peer.setpoints[-1].twist
    assert twist.angular.y == pytest.approx(-28.6478897565)
    assert twist.linear.z == pytest.approx(-HOVER)

    # The MPC is gone, the state goes on.
    peer.spin(0.3)
    peer.setpoints.clear()
    peer.spin(0.5)
    assert peer.setpoints == []
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 0
    assert "Traceback" not in (tmp_path / "rates_bridge.log").read_text()


def test_refuses_handover_with_two_command_sources(start: Start, peer: StackPeer) -> None:
    start("rates_bridge")
    assert peer.fly(lambda: peer.odometries and peer.engage.service_is_ready())
    rival = peer.node.create_publisher(TwistStamped, "command", qos_profile_sensor_data)
    assert peer.wait(rival.get_subscription_count)
    asked = peer.engage.call_async(SetBool.Request(data=True))
    assert peer.fly(asked.done)
    assert not asked.result().success
    # Discovery reports killed nodes for a while.
    assert re.search("[2-9] publishers on command, expected one", asked.result().message)
    peer.node.destroy_publisher(rival)
    assert peer.fly(lambda: peer.asked_to_engage())


class Others:
    """The health of an MPC and a reference, which state their vehicles."""

    def __init__(self, peer: StackPeer) -> None:
        self.vehicles = {name: BridgeConfig().vehicle_values() for name in ("mpc", "reference")}
        self._publisher = peer.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        peer.node.create_timer(0.1, self._publish)

    def _publish(self) -> None:
        for name, values in self.vehicles.items():
            stated = KeyValue(key=VEHICLE_KEY, value=json.dumps(values))
            status = DiagnosticStatus(name=f"/{name}", values=[stated])
            self._publisher.publish(DiagnosticArray(status=[status]))


def test_refuses_handover_while_nodes_have_different_vehicles(
    start: Start, peer: StackPeer, tmp_path: Path
) -> None:
    others = Others(peer)
    others.vehicles["reference"] = {**others.vehicles["reference"], "mass": 0.9, "drag": 0.2}
    others.vehicles["mpc"]["drag"] = 0.3  # may differ
    others.vehicles["simulator"] = {"mass": 5.0}  # what flies may be another vehicle
    arm = peer.node.create_client(SetBool, "rates_bridge/arm")
    start("rates_bridge")
    ready = (peer.engage.service_is_ready, arm.service_is_ready)
    assert peer.fly(lambda: peer.odometries and all(each() for each in ready))
    expected = (
        "vehicles differ: mass 0.396893 of rates_bridge and mpc, 0.9 of reference; give every "
        "node the same vehicle file"
    )
    log = tmp_path / "rates_bridge.log"
    assert peer.fly(lambda: "have different vehicle parameters" in log.read_text())
    engaging = peer.engage.call_async(SetBool.Request(data=True))
    assert peer.fly(engaging.done)
    assert (engaging.result().success, engaging.result().message) == (False, expected)
    arming = arm.call_async(SetBool.Request(data=True))
    assert peer.fly(arming.done)
    assert (arming.result().success, arming.result().message) == (False, expected)
    disengaging = peer.engage.call_async(SetBool.Request(data=False))
    assert peer.fly(disengaging.done)
    assert disengaging.result().success

    others.vehicles["reference"]["mass"] = others.vehicles["mpc"]["mass"]
    assert peer.fly(lambda: peer.asked_to_engage())


def test_refuses_handover_with_a_thrust_map_below_the_weight(
    start: Start, peer: StackPeer, tmp_path: Path
) -> None:
    map_ = ("-p", "thrust_map.kind:=linear", "-p", "thrust_map.full_thrust:=3.0")
    start("rates_bridge", *map_)
    assert peer.fly(lambda: peer.odometries and peer.engage.service_is_ready())
    engaging = peer.engage.call_async(SetBool.Request(data=True))
    assert peer.fly(engaging.done)
    assert not engaging.result().success
    assert "given hover throttle 1 for a weight of 3.89 N" in engaging.result().message
    assert "[WARN]" in (tmp_path / "rates_bridge.log").read_text()


class RefusingPx4:
    """PX4 over UDP, disarmed on the ground, which refuses to arm and says why."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._bridge = ("127.0.0.1", port)
        self._speaker = mavlink.Speaker()

    def live(self) -> None:
        """Report the state and answer what came."""
        state = {"autopilot": mavlink.PX4, "mode": mavlink.POSITION, "armed": False}
        self._send(
            self._speaker.state_messages(time.monotonic_ns(), land=mavlink.ON_GROUND, **state)
        )
        with contextlib.suppress(BlockingIOError):
            while data := self._socket.recv(65536):
                for request in mavlink.requests(data):
                    if request.command == 400 and request.parameters[0] == 1.0:
                        self._send(self._speaker.say("command_ack", 400, 1))
                        text = b"Arming denied: no valid position\t"
                        self._send(self._speaker.say("statustext", 2, text))

    def close(self) -> None:
        self._socket.close()

    def _send(self, data: bytes) -> None:
        self._socket.sendto(data, self._bridge)


def test_arm_service_answers_with_the_result_of_the_stack(
    start: Start, peer: StackPeer, tmp_path: Path
) -> None:
    """Not whether it was asked: PX4 refuses, and gives its reason in a text of its own."""
    pytest.importorskip("pymavlink")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    px4 = RefusingPx4(port)
    arm = peer.node.create_client(SetBool, "mavlink_bridge/arm")
    start("mavlink_bridge", "-p", f"device:=udpin:127.0.0.1:{port}")
    try:
        # The state has arrived as soon as odometry is published.
        assert peer.wait(lambda: [px4.live(), peer.odometries and arm.service_is_ready()][-1])
        for wanted, text in (
            (True, "temporarily rejected: Arming denied: no valid position"),
            (False, "disarmed"),
        ):
            asked = arm.call_async(SetBool.Request(data=wanted))
            assert peer.wait(lambda asked=asked: [px4.live(), asked.done()][-1])
            assert asked.result().success is not wanted
            assert asked.result().message.endswith(text)
    finally:
        px4.close()
    assert (
        "the autopilot reports: Arming denied: no valid position"
        in (tmp_path / "mavlink_bridge.log").read_text()
    )


def test_the_health_of_a_bridge_names_the_missing_heartbeat(peer: StackPeer) -> None:
    """Also while no command comes, which used to be all that it said: preflight reads it."""
    pytest.importorskip("pymavlink")
    node = node_module.BridgeNode(MavlinkBridge)
    try:
        health = node.report()
        expected = "no heartbeat of PX4 or ArduPilot within 1.5 s on udpin:127.0.0.1:14540"
        assert dict(health.values)["stack_fault"] == expected
        assert health.text == f"{expected}; silent: no commands from the mpc"
    finally:
        node.destroy_node()


LEAVING = """
import sys
import rclpy
from rclpy.node import Node
from quad_mpc_ros.ros import spin
from quad_mpc_ros.ros.bridges import node
from quad_mpc_ros.ros.bridges.rates import RatesBridge

class LeavingBridge(RatesBridge):
    def leave(self):
        return [self._message(self.publications[0])]

class Bridge(node.BridgeNode):
    def begin(self):
        import signal
        signal.raise_signal(signal.SIGINT)

    def _send(self, outgoing):
        super()._send(outgoing)
        print(rclpy.ok(), outgoing.topic.name)

bridge = lambda: Bridge(LeavingBridge)
nodes = [bridge] if sys.argv.pop() == "alone" else [lambda: Node("first"), bridge]
sys.exit(spin.run(nodes[0], others=nodes[1:]))
"""


@pytest.mark.parametrize("where", ["alone", "second of a process"])
def test_sends_its_last_messages_at_a_signal(where: str) -> None:
    run = subprocess.run(
        [sys.executable, "-P", "-c", LEAVING, where],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert (run.returncode, run.stdout) == (0, "True rates_setpoint\n"), run.stderr


def test_messages_of_another_release_are_refused_in_one_line(
    capfd: pytest.CaptureFixture[str],
) -> None:
    class OldBridge(RatesBridge):
        name = "old_bridge"
        how_to_get = "build the release of the vehicle"
        services = (("off", "std_srvs/srv/Nonesuch"),)

    assert run_bridge(OldBridge, ["--ros-args"]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line == (
        "error: old_bridge: the installed std_srvs is another release, without "
        "std_srvs/srv/Nonesuch: build the release of the vehicle"
    )


def test_one_name_for_two_types_is_refused_in_one_line(
    new: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(node_module, "_require", lambda kind: None)
    monkeypatch.setattr(node_module, "_new", new)
    assert (
        run_bridge(RosflightBridge, ["--ros-args", "-p", "advanced.mpc_command_topic:=command"])
        == 2
    )
    (line,) = capfd.readouterr().err.splitlines()
    assert "/command has the type rosflight_msgs/msg/Command in the stack" in line

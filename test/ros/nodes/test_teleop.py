"""The teleop node in a flight over DDS: a keyboard at a terminal, and a joystick."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.processes import end
from fixtures.pseudo_terminal import PseudoTerminal
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Joy

from quad_mpc_ros.messages import conversions
from quad_mpc_ros.ros.teleop.config import JoystickParameters

Start = Callable[..., "subprocess.Popen[bytes]"]
TELEOP = [sys.executable, "-m", "quad_mpc_ros.ros.nodes.teleop_node"]
STICKS = JoystickParameters()


@contextmanager
def at_a_terminal(*arguments: str) -> Iterator[PseudoTerminal]:
    """Run the node with a terminal to type at."""
    terminal = PseudoTerminal([*TELEOP, "--ros-args", *arguments])
    try:
        yield terminal
    finally:
        end(terminal.process)
        terminal.close()


class Flight:
    """What is seen of a flight, and the joystick in the test's hands."""

    def __init__(self, peer: Any) -> None:
        self._peer = peer
        self.position, self.velocity = np.zeros(3), np.zeros(3)
        self.mode = self.request = ""
        self.commands = 0
        node = peer.node
        node.create_subscription(Odometry, "odom", self._on_odometry, qos_profile_sensor_data)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        node.create_subscription(
            TwistStamped, "command", self._on_command, qos_profile_sensor_data
        )
        self._joystick = node.create_publisher(Joy, "joy", 10)

    def comes_into(self, mode: str) -> bool:
        return bool(self._peer.wait(lambda: self.mode == mode, timeout=30.0))

    def rests(self) -> bool:
        """Wait until it holds and hardly moves any more."""
        return bool(
            self._peer.wait(
                lambda: self.mode == "hold" and np.linalg.norm(self.velocity) < 0.1, timeout=15.0
            )
        )

    def hold_stick(self, seconds: float, *, forward: float, deadman: bool) -> None:
        """Let the joystick tell the same for some time."""
        message = Joy(axes=[0.0] * 6, buttons=[0] * 15)
        message.axes[STICKS.forward_axis] = forward
        message.buttons[STICKS.deadman_button] = int(deadman)
        for _ in range(round(20 * seconds)):
            self._joystick.publish(message)
            self._peer.spin(0.05)

    def _on_odometry(self, message: Odometry) -> None:
        odometry = conversions.odometry_from_message(message)
        self.position, self.velocity = odometry.p_WB, odometry.v_WB_B

    def _on_command(self, _: TwistStamped) -> None:
        self.commands += 1

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/reference":
                values = {pair.key: pair.value for pair in status.values}
                self.mode, self.request = values.get("mode", ""), values.get("request", "")


def test_a_flight_by_keys_and_joystick(start: Start, peer: Any) -> None:
    """Take-off, a metre by key, a joystick let go and one lost, landing; in real time."""
    flight = Flight(peer)
    start("mpc")
    start("reference", "-p", "mode:=on_request", "-p", "takeoff_height:=1.0")
    start("simulator", "-p", "duration:=0.0")
    with at_a_terminal() as keys:
        assert peer.wait(lambda: flight.commands, timeout=90.0)  # the mpc may compile first
        assert flight.comes_into("ground")
        assert peer.wait(lambda: "take-off" in keys.shown)
        assert peer.wait(lambda: keys.settings() != keys.before)  # keys come at once

        # Nothing flies before the take-off, and refusals are shown.
        assert peer.wait(
            lambda: keys.type("h") or peer.spin(0.3) or "no hold while in ground" in keys.shown
        )
        assert peer.wait(
            lambda: keys.type("w") or peer.spin(0.3) or "no velocity while in gro" in keys.shown
        )
        assert flight.position[2] < 0.05
        keys.type("t")
        assert flight.comes_into("hold")
        assert flight.position[2] == pytest.approx(1.0, abs=0.2)

        # A key, repeated as terminals do.
        begin = flight.position
        for _ in range(30):
            keys.type("w")
            peer.spin(0.05)
        assert flight.rests()
        way = flight.position - begin
        assert 1.0 < way[0] < 3.0  # 1.5 s at 1 m/s, and to brake
        assert abs(way[1]) < 0.3
        assert flight.position[2] == pytest.approx(1.0, abs=0.2)

        # A stick: its deadman button is let go while it is still pushed.
        flight.hold_stick(0.3, forward=-1.0, deadman=False)
        assert flight.mode == "hold"
        flight.hold_stick(1.5, forward=-1.0, deadman=True)
        assert flight.mode == "velocity"
        assert np.linalg.norm(flight.velocity) > 0.5
        released = flight.position
        flight.hold_stick(0.5, forward=-1.0, deadman=False)
        assert flight.rests()
        assert np.linalg.norm(flight.position - released) < 1.2

        # A joystick that is lost while it is pushed.
        flight.hold_stick(1.0, forward=1.0, deadman=True)
        lost = flight.position
        assert peer.wait(lambda: "no message of the joystick" in keys.shown)
        assert flight.rests()
        assert np.linalg.norm(flight.position - lost) < 2.0

        keys.type("l")
        assert flight.comes_into("landing")
        assert flight.comes_into("ground")
        assert flight.position[2] < 0.1
        keys.type("x")
        assert keys.process.wait(10) == 0
        assert keys.settings() == keys.before


def test_without_terminal_and_joystick_it_says_so_and_ends() -> None:
    done = subprocess.run(TELEOP, stdin=subprocess.DEVNULL, capture_output=True, timeout=60)
    assert done.returncode == 2
    told = done.stderr.decode()
    assert "no terminal to read keys from" in told
    assert "nobody publishes joy" in told
    assert "Traceback" not in told


def test_a_keyboard_without_a_terminal_is_bad_input() -> None:
    done = subprocess.run(
        [*TELEOP, "--ros-args", "-p", "input:=keyboard"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert done.stderr.decode().startswith("error: no terminal to read keys from")


@pytest.mark.parametrize("how", ["interrupted", "terminated"])
def test_the_terminal_is_restored_however_the_node_ends(how: str, peer: Any) -> None:
    with at_a_terminal() as keys:
        assert peer.wait(lambda: keys.settings() != keys.before)
        peer.spin(0.3)
        if how == "interrupted":
            keys.type("\x03")
        else:
            keys.process.terminate()
        keys.process.wait(15)
        assert keys.settings() == keys.before
        assert "Traceback" not in keys.shown


def test_position_mode_asks_for_steps_from_where_the_reference_leads(peer: Any, feed: Any) -> None:
    goals: list[PoseStamped] = []
    velocities: list[TwistStamped] = []
    peer.node.create_subscription(PoseStamped, "goal_pose", goals.append, 10)
    peer.node.create_subscription(
        TwistStamped, "cmd_vel", velocities.append, qos_profile_sensor_data
    )
    feed.yaw = np.pi / 2  # the nose points north, at two metres
    with at_a_terminal("-p", "mode:=position", "-p", "step:=0.4") as keys:
        assert peer.wait(lambda: peer.node.count_publishers("goal_pose"))
        deadline = time.monotonic() + 10.0
        while not goals and time.monotonic() < deadline:
            keys.type("w")
            peer.spin(0.5)
        sent = len(goals)
        keys.type("a")
        assert peer.wait(lambda: len(goals) > sent)
    first, last = goals[-2].pose.position, goals[-1].pose.position
    assert goals[-1].header.frame_id == "odom"
    assert [goals[0].pose.position.x, goals[0].pose.position.z] == pytest.approx([0.0, 2.0])
    assert goals[0].pose.position.y % 0.4 == pytest.approx(0.0, abs=1e-9) or sent > 1
    assert [last.x - first.x, last.y - first.y] == pytest.approx([-0.4, 0.0])
    assert not velocities

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Take a simulated PX4 over and give it back, again and again, and print how much it tilted.

    python tools/px4_handovers.py --config vehicle.yaml [--bridge mavlink] [--external] [--sticks]
                                  [--out DIR] [--station udpin:127.0.0.1:14550]

PX4 runs already, in real time, disarmed on the ground; by px4_bridge its uXRCE-DDS agent does as
well, and px4_msgs is there: docs/howto/stacks/px4.md. The nodes are started here, each a process:
mpc, reference and the bridge. The pilot is a ground station, to which PX4 speaks MAVLink. Not for
a real vehicle: in the air the MPC is killed, and PX4 is switched to hold. With --external the
ground station selects the mode quad MPC (px4_bridge, mode: external) instead of calling engage.
With --sticks the ground station also sends the sticks, and takes over by them: COM_RC_IN_MODE 1,
COM_RC_OVERRIDE 3.

Each line is one handover: who flies after it, and by how much [deg] the vehicle tilted more than
the reference asks for, from it until the next; all of it where PX4 flies by itself. The exit code
is 1 where one was not as expected.
"""

from __future__ import annotations

import argparse
import functools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.messages.topics import ENGAGED, ODOMETRY, REFERENCE
from quad_mpc_ros.ros.bridges.line import line_to
from quad_mpc_ros.ros.bridges.mavlink import codec
from quad_mpc_ros.ros.messages import message_class, odometry_in, qos_of, reference_in
from quad_mpc_ros.ros.spin import fastest_executor

BRIDGES = "px4", "mavlink"
MOST_TILT = 20.0  # degrees beyond what the reference asks for
PATIENCE = 60.0  # s
REQUEST_PERIOD = 0.1  # s, for the mode
STICK_PERIOD = 0.05  # s
TAKE_OFF = 22  # MAV_CMD
# Main and sub modes, px4_custom_mode.h
OFFBOARD, HOLD, EXTERNAL, POSITION = (6, 0), (4, 3), (4, 11), (3, 0)
CUSTOM, ARMED = 1, 128  # bits of MAV_MODE_FLAG


class Handover(NamedTuple):
    """An action, and the expected source of commands afterwards, for a time [s].

    ``sticks``: it requires sticks.
    """

    name: str
    act: Callable[[Rig], None]
    offboard: bool
    seconds: float = 8.0
    sticks: bool = False


class Station:
    """A ground station: the state of PX4, and the commands of a pilot."""

    def __init__(self, device: str) -> None:
        self._line = line_to(device, 0)
        self._codec = codec.Codec(system=255)
        self._requested, self._moved = 0.0, 0.0
        self.system, self.mode, self.armed = 0, (0, 0), False
        self.roll: int | None = None
        """Stick of roll, 1000 to the right; None sends no sticks."""

    def poll(self) -> None:
        """Read messages, and request a heartbeat: PX4 accepts no interval for it."""
        for message in self._codec.read(self._line.read()):
            autopilot = message.get_srcComponent() == codec.AUTOPILOT_COMPONENT
            if autopilot and message.get_msgId() == codec.HEARTBEAT:
                self.system = message.get_srcSystem()
                self.mode = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24
                self.armed = bool(message.base_mode & ARMED)
        if self.system and time.monotonic() - self._requested > REQUEST_PERIOD:
            self._requested = time.monotonic()
            self.send(codec.REQUEST_MESSAGE, codec.HEARTBEAT)
        sends = self.system and self.roll is not None
        if sends and time.monotonic() - self._moved > STICK_PERIOD:
            self._moved = time.monotonic()
            sticks = {"x": 0, "y": self.roll, "z": 500, "r": 0, "buttons": 0}
            message = codec.dialect().MAVLink_manual_control_message(self.system, **sticks)
            self._line.write(self._codec.packed(message))

    def send(self, command: int, *parameters: float) -> None:
        """Send a command."""
        target = {"system": self.system, "component": codec.AUTOPILOT_COMPONENT}
        message = codec.command_long(command, *parameters, **target)
        self._line.write(self._codec.packed(message))

    def select(self, mode: tuple[int, int]) -> None:
        """Switch to a mode."""
        self.send(codec.DO_SET_MODE, CUSTOM + ARMED * self.armed, *map(float, mode))


class Rig:
    """The nodes, a ground station, and a node that calls services and watches."""

    def __init__(
        self, config: list[str], *, bridge: str, mode: tuple[int, int], station: Station, out: Path
    ) -> None:
        self._config, self._out, self._mode = config, out, mode
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._node = rclpy.create_node("px4_handovers")
        self._executor = fastest_executor(message_info=False)
        self._executor.add_node(self._node)
        self._window = ReferenceWindow.hover((0.0, 0.0, 0.0))
        self.bridge, self.station = f"{bridge}_bridge", station
        self.tilt, self.height, self.engaged = 0.0, 0.0, False
        self._received, self.where = 0, ""
        self._subscribe(ODOMETRY, self._on_odometry, raw=True)
        self._subscribe(REFERENCE, self._on_reference, raw=True)
        self._subscribe(ENGAGED, lambda message: setattr(self, "engaged", bool(message.data)))
        self._node.create_timer(0.02, station.poll)

    @property
    def nodes(self) -> dict[str, str]:
        """The code that runs each node."""
        return {
            "mpc": "from quad_mpc_ros.ros.nodes.mpc_node import main",
            "reference": "from quad_mpc_ros.ros.nodes.reference_node import main",
            self.bridge: f"from quad_mpc_ros.entry import {self.bridge} as main",
        }

    def _subscribe(
        self, topic: Any, callback: Callable[[Any], None], *, raw: bool = False
    ) -> None:
        kind = message_class(topic.type_name)
        self._node.create_subscription(kind, topic.name, callback, qos_of(topic), raw=raw)

    def _on_odometry(self, data: bytes) -> None:
        self._received += 1
        if self._received % 8:  # nothing turns that fast
            return
        odometry = odometry_in(data)
        self.height = float(odometry.p_WB[2])
        tilt = tilt_of(so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw))
        if self.engaged:  # else the reference is not tracked and waits at the vehicle
            tilt -= tilt_of(sample(self._window, odometry.stamp_ns).R_WB)
        if tilt > self.tilt:
            self.tilt, self.where = tilt, "armed" if self.station.armed else "disarmed"
            self.where += f", at {self.height:.2f} m"

    def _on_reference(self, data: bytes) -> None:
        self._window = reference_in(data)

    @property
    def is_offboard(self) -> bool:
        """Whether PX4 follows the commands of the MPC."""
        return self.station.mode == self._mode

    def engage(self) -> None:
        """Request the handover."""
        if self._mode == OFFBOARD:
            self.ask(f"{self.bridge}/engage", True)
            return
        select = functools.partial(self.station.select, self._mode)
        self.wait(lambda: self.is_offboard, "in the mode of the MPC", select)

    def start(self, name: str) -> None:
        """Start a node."""
        files_given = [part for file in self._config for part in ("--params-file", file)]
        if name == "reference":
            files_given += ["-p", "mode:=on_request"]
        script = f"import sys; {self.nodes[name]}; sys.exit(main())"
        command = [sys.executable, "-P", "-c", script, "--ros-args", *files_given]
        with (self._out / f"{name}.log").open("ab") as log:
            self._processes[name] = subprocess.Popen(command, stdout=log, stderr=log)

    def kill(self, name: str) -> None:
        """End a node without a word."""
        self._processes[name].kill()
        self._processes[name].wait()

    def stop(self) -> None:
        """End all of them."""
        for process in self._processes.values():
            process.send_signal(signal.SIGINT)
        for process in self._processes.values():
            process.wait(20)

    def ask(self, service: str, wanted: bool | None = None) -> None:
        """Ask every second until it is granted; a service without ``wanted`` is a trigger."""
        kind = Trigger if wanted is None else SetBool
        client = self._node.create_client(kind, service)
        request = kind.Request() if wanted is None else kind.Request(data=wanted)
        give_up, answer, reason = time.monotonic() + PATIENCE, None, ""
        while answer is None or not answer.success:
            if time.monotonic() > give_up:
                raise TimeoutError(f"{service}: {getattr(answer, 'message', 'no answer')}")
            self.spin(1.0 if answer is not None else 0.1)
            if client.service_is_ready():
                future = client.call_async(request)
                self._executor.spin_until_future_complete(future, timeout_sec=5.0)
                answer = future.result()
                if answer is not None and not answer.success and answer.message != reason:
                    reason = answer.message
                    print(f"  {service}: {reason}", flush=True)

    def spin(self, seconds: float) -> None:
        """Listen for a time [s]."""
        self._executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def wait(
        self, condition: Callable[[], bool], what: str, ask: Callable[[], None] = lambda: None
    ) -> None:
        """Listen until something is so; ask for it every second."""
        give_up, asked = time.monotonic() + PATIENCE, 0.0
        while not condition():
            if time.monotonic() > give_up:
                raise TimeoutError(f"not {what}")
            if time.monotonic() - asked > 1.0:
                asked = time.monotonic()
                ask()
            self.spin(0.05)


def tilt_of(R_WB: np.ndarray) -> float:
    """Return the angle between thrust and up [deg]."""
    return float(np.degrees(np.arccos(np.clip(R_WB[2, 2], -1.0, 1.0))))


def engage(rig: Rig) -> None:
    """Take over in the air."""
    rig.engage()
    rig.wait(lambda: rig.engaged, "engaged")


def take_off(rig: Rig) -> None:
    """Take over on the ground, and take off."""
    rig.engage()
    rig.ask(f"{rig.bridge}/arm", True)
    rig.wait(lambda: rig.engaged, "engaged")
    rig.ask("reference/takeoff")
    rig.wait(lambda: rig.height > 1.5, "in the air")


def kill(rig: Rig) -> None:
    """Kill the MPC, and wait for PX4 to find out."""
    rig.kill("mpc")
    rig.wait(lambda: not rig.is_offboard, "taken over by PX4's failsafe")


def restart(rig: Rig) -> None:
    """Start the MPC again, and end PX4's failsafe; nothing is requested."""
    rig.start("mpc")
    rig.station.select(HOLD)


def pilot_takes_over(rig: Rig) -> None:
    """Switch to hold, as a pilot or a ground station does."""
    rig.station.select(HOLD)
    rig.wait(lambda: rig.station.mode == HOLD and not rig.engaged, "in hold")


def pilot_moves_a_stick(rig: Rig) -> None:
    """Move the stick of roll until PX4 is in position mode."""
    rig.station.roll = 600
    rig.wait(lambda: rig.station.mode == POSITION and not rig.engaged, "in position mode")
    rig.station.roll = 0


def land(rig: Rig) -> None:
    """Land, until PX4 disarms by itself."""
    rig.ask("reference/land")
    rig.wait(lambda: not rig.station.armed, "disarmed")


def px4_takes_off(rig: Rig) -> None:
    """Let PX4 take off by itself."""
    rig.station.send(TAKE_OFF, 0.0, 0.0, 0.0, *4 * [float("nan")])
    rig.spin(0.5)
    rig.station.send(codec.COMPONENT_ARM_DISARM, 1.0)
    rig.wait(lambda: rig.height > 1.5 and rig.station.mode == HOLD, "hovering by itself")


FLIGHTS = (
    Handover("take-off by the MPC", take_off, offboard=True),
    Handover("MPC killed: PX4's failsafe", kill, offboard=False),
    Handover("MPC restarted, failsafe ended", restart, offboard=False),
    Handover("engaged in the air", engage, offboard=True),
    Handover("pilot takes over by mode", pilot_takes_over, offboard=False),
    Handover("pilot gives back: engaged", engage, offboard=True),
    Handover("pilot takes over by a stick", pilot_moves_a_stick, offboard=False, sticks=True),
    Handover("pilot gives back: engaged", engage, offboard=True, sticks=True),
    Handover("landed, disarmed by PX4", land, offboard=True, seconds=3.0),
    Handover("take-off by PX4", px4_takes_off, offboard=False),
    Handover("engaged after PX4's take-off", engage, offboard=True),
    Handover("lemniscate", lambda rig: rig.ask("reference/start"), offboard=True, seconds=30.0),
    Handover("landed, disarmed by PX4", land, offboard=True, seconds=3.0),
)


@contextmanager
def running(rig: Rig) -> Iterator[None]:
    """Start all nodes, and end them at the end of the block."""
    try:
        for name in rig.nodes:
            rig.start(name)
        yield
    finally:
        rig.stop()


def main() -> int:
    """Fly, and print a line a handover."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--config", action="append", required=True, metavar="FILE")
    parser.add_argument(
        "--bridge", choices=BRIDGES, default="px4", help="what the MPC flies by (default: px4)"
    )
    parser.add_argument(
        "--external", action="store_true", help="px4_bridge flies in a mode of its own"
    )
    parser.add_argument("--sticks", action="store_true", help="the pilot has sticks as well")
    parser.add_argument(
        "--station",
        default="udpin:127.0.0.1:14550",
        metavar="LINE",
        help="where PX4 speaks to ground stations (default: %(default)s)",
    )
    parser.add_argument("--out", type=Path, default=Path(), help="folder for the nodes' logs")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    station = Station(options.station)
    station.roll = 0 if options.sticks else None
    mode = EXTERNAL if options.external else OFFBOARD
    rig = Rig(options.config, bridge=options.bridge, mode=mode, station=station, out=options.out)
    wrong = 0
    with running(rig):
        try:
            rig.wait(lambda: station.system > 0, f"a vehicle on {options.station}")
        except TimeoutError as error:
            print(f"PX4: {error} within {PATIENCE:.0f} s", flush=True)
            return 1
        print(f"{'handover':32} {'flies':>10} {'tilt beyond [deg]':>18}", flush=True)
        for each in FLIGHTS:
            if each.sticks and not options.sticks:
                continue
            rig.tilt = 0.0
            try:
                each.act(rig)
            except TimeoutError as error:
                print(f"{each.name}: {error} within {PATIENCE:.0f} s", flush=True)
                return 1
            rig.spin(each.seconds)
            good = rig.is_offboard is each.offboard and rig.tilt <= MOST_TILT
            wrong += not good
            flies = "MPC" if rig.is_offboard else f"PX4 {station.mode}"
            line = f"{each.name:32} {flies:>10} {rig.tilt:18.1f}  {rig.where}"
            print(f"{line}{'' if good else '  <-'}", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

"""Take a simulated PX4 over and give it back, again and again, and print how much it tilted.

    python tools/px4_handovers.py --config vehicle.yaml [--out DIR]

PX4 and its uXRCE-DDS agent run already, in real time, disarmed on the ground, and px4_msgs is
there (docs/stacks/px4.md). The nodes are started here, each a process: mpc, reference and
px4_bridge. Not for a real vehicle: in the air the MPC is killed, and PX4 is switched to hold.

Each line is one handover: who flies after it, and by how much [deg] the vehicle tilted more than
the reference asks for, from it until the next; all of it where PX4 flies by itself. The exit code
is 1 where one was not as expected.
"""

from __future__ import annotations

import argparse
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

from quad_mpc_ros.configuration import files
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.messages.topics import ENGAGED, ODOMETRY, REFERENCE
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.ros.bridges.px4 import (
    ARMING_STATE_ARMED,
    NAVIGATION_STATE_OFFBOARD,
    VEHICLE_CMD_COMPONENT_ARM_DISARM,
    VEHICLE_CMD_DO_SET_MODE,
    Px4Bridge,
)
from quad_mpc_ros.ros.messages import (
    message_class,
    new_message,
    odometry_in,
    qos_of,
    reference_in,
)
from quad_mpc_ros.ros.spin import fastest_executor

NODES = {  # what runs each
    "mpc": "from quad_mpc_ros.ros.nodes.mpc_node import main",
    "reference": "from quad_mpc_ros.ros.nodes.reference_node import main",
    "px4_bridge": "from quad_mpc_ros.entry import px4_bridge as main",
}
SCHEMA = {"mpc": MpcConfig, "reference": ReferenceConfig, "px4_bridge": Px4Bridge.Config}
MOST_TILT = 20.0  # degrees beyond what the reference asks for
PATIENCE = 60.0  # s
TAKE_OFF = 22  # MAV_CMD
HOLD = (1.0, 4.0, 3.0)  # custom mode, auto, loiter
LOITER = 4  # of nav_state


class Handover(NamedTuple):
    """What is done, and who has to fly from then on, for how long [s]."""

    name: str
    act: Callable[[Rig], None]
    offboard: bool
    seconds: float = 8.0


class Rig:
    """The nodes, and a node that calls services, sends PX4 a pilot's commands, and watches."""

    def __init__(
        self, config: list[str], *, bridge: Px4Bridge, target_system: int, out: Path
    ) -> None:
        self._config, self._out = config, out
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._node = rclpy.create_node("px4_handovers")
        self._executor = fastest_executor(message_info=False)
        self._executor.add_node(self._node)
        self._target, self._window = target_system, ReferenceWindow.hover((0.0, 0.0, 0.0))
        self.tilt, self.height, self.nav_state = 0.0, 0.0, -1
        self.armed = self.engaged = False
        self._received, self.where = 0, ""
        self._subscribe(ODOMETRY, self._on_odometry, raw=True)
        self._subscribe(REFERENCE, self._on_reference, raw=True)
        self._subscribe(ENGAGED, lambda message: setattr(self, "engaged", bool(message.data)))
        topics = {each.topic.name.rpartition("/")[2]: each.topic for each in bridge.subscriptions}
        (status,) = (topic for name, topic in topics.items() if name.startswith("vehicle_status"))
        self._subscribe(status, self._on_status)
        (command,) = (each for each in bridge.publications if "vehicle_command" in each.name)
        self._commands = self._node.create_publisher(
            message_class(command.type_name), command.name, qos_of(command)
        )

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
        if self.engaged:  # else nobody flies the reference, which waits where the vehicle is
            tilt -= tilt_of(sample(self._window, odometry.stamp_ns).R_WB)
        if tilt > self.tilt:
            self.tilt, self.where = tilt, "armed" if self.armed else "disarmed"
            self.where += f", at {self.height:.2f} m"

    def _on_reference(self, data: bytes) -> None:
        self._window = reference_in(data)

    def _on_status(self, message: Any) -> None:
        self.nav_state, self.armed = (
            int(message.nav_state),
            int(message.arming_state) == ARMING_STATE_ARMED,
        )

    @property
    def is_offboard(self) -> bool:
        """Whether PX4 flies by what the MPC commands."""
        return self.nav_state == NAVIGATION_STATE_OFFBOARD

    def start(self, name: str) -> None:
        """Start a node."""
        files_given = [part for file in self._config for part in ("--params-file", file)]
        if name == "reference":
            files_given += ["-p", "mode:=on_request"]
        script = f"import sys; {NODES[name]}; sys.exit(main())"
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

    def send(self, command: int, *parameters: float) -> None:
        """Send PX4 a command as a ground station does."""
        message = new_message("px4_msgs/msg/VehicleCommand")
        message.command = command
        for number, value in enumerate(parameters, start=1):
            setattr(message, f"param{number}", value)
        message.target_system, message.target_component = self._target, 1
        message.source_system, message.source_component = 255, 190
        message.from_external = True
        self._commands.publish(message)

    def spin(self, seconds: float) -> None:
        """Listen for a time [s]."""
        self._executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Listen until something is so."""
        give_up = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > give_up:
                raise TimeoutError(f"not {what}")
            self.spin(0.05)


def tilt_of(R_WB: np.ndarray) -> float:
    """Return by how much the thrust points away from up [deg]."""
    return float(np.degrees(np.arccos(np.clip(R_WB[2, 2], -1.0, 1.0))))


def engage(rig: Rig) -> None:
    """Take over in the air."""
    rig.ask("px4_bridge/engage", True)
    rig.wait(lambda: rig.engaged, "engaged")


def take_off(rig: Rig) -> None:
    """Take over on the ground, and take off."""
    rig.ask("px4_bridge/engage", True)
    rig.ask("px4_bridge/arm", True)
    rig.wait(lambda: rig.engaged, "engaged")
    rig.ask("reference/takeoff")
    rig.wait(lambda: rig.height > 1.5, "in the air")


def kill(rig: Rig) -> None:
    """Kill the MPC, and wait for PX4 to find out."""
    rig.kill("mpc")
    rig.wait(lambda: not rig.is_offboard, "taken over by PX4's failsafe")


def restart(rig: Rig) -> None:
    """Start the MPC again; nothing is requested."""
    rig.start("mpc")


def pilot_takes_over(rig: Rig) -> None:
    """Switch to hold, as a pilot or a ground station does."""
    rig.send(VEHICLE_CMD_DO_SET_MODE, *HOLD)
    rig.wait(lambda: rig.nav_state == LOITER and not rig.engaged, "in hold")


def land(rig: Rig) -> None:
    """Land, until PX4 disarms by itself."""
    rig.ask("reference/land")
    rig.wait(lambda: not rig.armed, "disarmed")


def px4_takes_off(rig: Rig) -> None:
    """Let PX4 take off by itself."""
    rig.send(TAKE_OFF, 0.0, 0.0, 0.0, float("nan"), float("nan"), float("nan"), float("nan"))
    rig.spin(0.5)
    rig.send(VEHICLE_CMD_COMPONENT_ARM_DISARM, 1.0)
    rig.wait(lambda: rig.height > 1.5 and rig.nav_state == LOITER, "hovering by itself")


FLIGHTS = (
    Handover("take-off by the MPC", take_off, offboard=True),
    Handover("MPC killed: PX4's failsafe", kill, offboard=False),
    Handover("MPC restarted, nothing asked", restart, offboard=False),
    Handover("engaged in the air", engage, offboard=True),
    Handover("pilot takes over by mode", pilot_takes_over, offboard=False),
    Handover("pilot gives back: engaged", engage, offboard=True),
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
        for name in NODES:
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
    parser.add_argument("--out", type=Path, default=Path(), help="folder for the nodes' logs")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    given = files.load(options.config, [], schema=SCHEMA)["px4_bridge"]
    rclpy.init()
    bridge, target = Px4Bridge(given, new_message), given.target_system
    rig = Rig(options.config, bridge=bridge, target_system=target, out=options.out)
    wrong = 0
    with running(rig):
        print(f"{'handover':32} {'flies':>10} {'tilt beyond [deg]':>18}", flush=True)
        for each in FLIGHTS:
            rig.tilt = 0.0
            try:
                each.act(rig)
            except TimeoutError as error:
                print(f"{each.name}: {error} within {PATIENCE:.0f} s", flush=True)
                return 1
            rig.spin(each.seconds)
            good = rig.is_offboard is each.offboard and rig.tilt <= MOST_TILT
            wrong += not good
            flies = "MPC" if rig.is_offboard else f"PX4 ({rig.nav_state})"
            line = f"{each.name:32} {flies:>10} {rig.tilt:18.1f}  {rig.where}"
            print(f"{line}{'' if good else '  <-'}", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

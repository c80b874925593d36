# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly PX4, real or simulated, from take-off to landing, several times, and print how well.

    python tools/fly_px4.py --config vehicle.yaml [--bridge mavlink] [--flights 5 | --short]
                            [--out DIR] [--set N.P=V]

PX4 runs already, disarmed on the ground. By px4_bridge its uXRCE-DDS agent does as well, and
px4_msgs is there (docs/howto/stacks/px4.md); by mavlink_bridge neither is needed.
Bridge, reference and controller are those of the nodes, in this one process; PX4's own stamps are
the clock, so a simulator slower than the wall clock does no harm.
Each flight: engage, arm, take off, hover for 20 s, the reference of the configuration for 32 s,
goals at the corners of a square of 2 m, land, and wait until PX4 disarms by itself. A short one
hovers for 4 s and lands.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

from quad_mpc_ros.configuration import files
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory, joined_trajectory
from quad_mpc_ros.references.director import Reply
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.ros.bridges.bridge import Bridge, OutgoingMessage, Response
from quad_mpc_ros.ros.bridges.mavlink import MavlinkBridge
from quad_mpc_ros.ros.bridges.mavlink.codec import Codec
from quad_mpc_ros.ros.bridges.px4 import Px4Bridge
from quad_mpc_ros.ros.messages import message_class, new_message, qos_of

BRIDGES: dict[str, type[Bridge]] = {"px4": Px4Bridge, "mavlink": MavlinkBridge}
SCHEMA = {"mpc": MpcConfig, "reference": ReferenceConfig}
SCHEMA |= {kind.name: kind.Config for kind in BRIDGES.values()}
CORNERS = ((1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))
COLUMNS = (
    *("time", "x", "y", "z", "x_ref", "y_ref", "z_ref", "speed", "tilt", "tilt_ref"),
    *("throttle", "roll_rate", "pitch_rate", "yaw_rate", "thrust_scale", "disturbance", "not_mpc"),
)


@dataclass
class Phase:
    """A part of a flight: its request, its duration [s], and its criteria."""

    name: str
    ask: Callable[[Pilot], Reply | Response | None]
    seconds: float
    settled: float = 0.0
    rows: list[list[float]] = field(default_factory=list)


class Pilot:
    """Bridge, reference and controller, driven by PX4's messages."""

    def __init__(self, config: dict[str, Any], node: Any, kind: type[Bridge]) -> None:
        self.mpc, reference = config["mpc"], config["reference"]
        self._bridge = kind.configured(config[kind.name], new_message)
        self._line = self._bridge.line
        self._clock = Codec(system=1) if self._line is not None else None
        self._controller: Controller = warmed_up(self.mpc)
        trajectory = configured_trajectory(reference)
        self._live = LiveReference(
            reference, trajectory, joined=lambda: joined_trajectory(reference)
        )
        self._publishers = {
            topic.name: node.create_publisher(
                message_class(topic.type_name), topic.name, qos_of(topic)
            )
            for topic in self._bridge.publications
        }
        for subscription in self._bridge.subscriptions:
            topic = subscription.topic
            node.create_subscription(
                message_class(topic.type_name),
                topic.name,
                self._receiver(subscription),
                qos_of(topic),
            )
        self.now_ns, self.engaged, self.home = 0, False, np.zeros(3)
        self._last_ns, self._landed = 0, None
        self._waiting: list[OdometrySample] = []
        self._set_engaged(False)

    def _receiver(self, subscription: Any) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            if "odometry" in subscription.topic.name:
                self.now_ns = max(self.now_ns, 1000 * int(message.timestamp))
            subscription.receive(message, self.now_ns)
            self._send(self._bridge.take_outgoing())
            self._waiting += [odometry for odometry, _ in self._bridge.take_odometries()]

        return receive

    def listen(self, executor: Any) -> None:
        """Receive a message, if one arrives soon."""
        if self._line is None or self._clock is None:
            executor.spin_once(timeout_sec=0.1)
            return
        time.sleep(0.001)
        data = self._line.read()
        for message in self._clock.read(data):
            if message.get_type() == "ODOMETRY":
                self.now_ns = max(self.now_ns, 1000 * int(message.time_usec))
        self._line.write(self._bridge.exchange(data, now_ns=self.now_ns))
        self._waiting += [odometry for odometry, _ in self._bridge.take_odometries()]

    def ticks(self) -> Iterator[tuple[OdometrySample, ReferenceWindow, Tick]]:
        """Answer the odometries that came at the control rate; yield what was done."""
        period_ns = 0.75e9 / self.mpc.control_rate
        while self._waiting:
            odometry = self._waiting.pop(0)
            if odometry.stamp_ns - self._last_ns < period_ns:
                continue
            self._last_ns = odometry.stamp_ns
            self._follow()
            event = self._live.observe(odometry)
            if event is not None:
                print(f"  {event.text}", flush=True)
            window = self._live.window(odometry.stamp_ns)
            if window is None:
                continue
            self._bridge.receive_reference(window, now_ns=self.now_ns)
            self._controller.receive_reference(window, now_ns=self.now_ns)
            tick = self._controller.receive_odometry(odometry, now_ns=self.now_ns)
            for warning in self._controller.take_warnings() + self._bridge.take_warnings():
                print(f"  {warning}", flush=True)
            self._live.set_ground_state(self._controller.ground_state)
            self._bridge.receive_ground(self._controller.ground_state)
            if tick is None:
                continue
            if tick.command is not None:
                self._send(self._bridge.receive_command(tick.command, now_ns=self.now_ns))
            yield odometry, window, tick

    def _follow(self) -> None:
        engaged = self._bridge.engaged(now_ns=self.now_ns)
        if engaged is not self.engaged:
            self._set_engaged(engaged)
        landed = self._bridge.landed(now_ns=self.now_ns)
        if landed is not None and landed is not self._landed:
            self._landed = landed
            self._controller.landed(landed)
            self._live.landed(landed)

    def _set_engaged(self, engaged: bool) -> None:
        self.engaged = engaged
        self._controller.engage(engaged)
        self._live.engage(engaged)

    def _send(self, outgoing: Any) -> None:
        for each in outgoing:
            if isinstance(each, OutgoingMessage):
                self._publishers[each.topic.name].publish(each.message)
            elif isinstance(each, bytes) and self._line is not None:
                self._line.write(each)

    def engage(self) -> Response:
        """Ask for the handover."""
        return self._asked(self._bridge.engage(True, now_ns=self.now_ns))

    def arm(self) -> Response:
        """Ask to be armed."""
        return self._asked(self._bridge.arm(True, now_ns=self.now_ns))

    def _asked(self, response: Response) -> Response:
        self._send(response.messages)
        return response

    def take_off(self) -> Reply:
        """Take off where it stands."""
        return self._live.take_off(self._last_ns)

    def start(self) -> Reply:
        """Fly the trajectory that is configured."""
        return self._live.start(self._last_ns)

    def land(self) -> Reply:
        """Land."""
        return self._live.land(self._last_ns)

    def go_to(self, corner: tuple[float, float]) -> Reply:
        """Fly to a corner of the square about where it took off, level with heading 0."""
        goal = np.array([*(self.home[:2] + corner), self.home[2] + 2.5])
        q = np.array([0.0, 0.0, 0.0, 1.0])
        return self._live.go_to(self._last_ns, frame_id="odom", p_WB=goal, q_WB_xyzw=q)


def course(*, short: bool) -> list[Phase]:
    """Return the phases of one flight in the air."""
    about = [
        Phase("reference", lambda pilot: pilot.start(), 32.0, settled=4.0),
        *(
            Phase(f"corner {k + 1}", lambda pilot, at=corner: pilot.go_to(at), 6.0, settled=4.0)
            for k, corner in enumerate(CORNERS)
        ),
    ]
    return [
        Phase("take off", lambda pilot: pilot.take_off(), 6.0),
        Phase("hover", lambda pilot: None, 4.0 if short else 20.0),
        *(() if short else about),
        Phase("land", lambda pilot: pilot.land(), 10.0),
    ]


def row(
    odometry: OdometrySample, window: ReferenceWindow, tick: Tick, began_ns: int
) -> list[float]:
    """Return one line of the log, see ``COLUMNS``: m, s, rad."""
    up = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)[2, 2]
    up_ref = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw[0])[2, 2]
    stats, command = tick.stats, tick.command
    push = np.hypot(np.hypot(stats.disturbance_x, stats.disturbance_y), stats.disturbance_z)
    inputs = [command.throttle, *command.w_WB_B] if command is not None else [np.nan] * 4
    return [
        (odometry.stamp_ns - began_ns) * 1e-9,
        *odometry.p_WB,
        *window.p_WB[0],
        odometry.speed,
        *np.arccos(np.clip([up, up_ref], -1.0, 1.0)),
        *inputs,
        stats.thrust_scale,
        push,
        float(stats.source not in ("mpc", "idle")),
    ]


def describe(name: str, rows: list[list[float]], bound: float) -> str:
    """Return the errors of a phase as a line."""
    log = np.array(rows)
    error = np.linalg.norm(log[:, 1:4] - log[:, 4:7], axis=1)
    at_bound = np.mean(np.abs(log[:, 11:14]).max(axis=1) >= bound)
    return (
        f"{name:12} {error.mean():8.3f} {error.max():8.3f} {log[:, 7].max():8.2f} "
        f"{np.degrees(log[:, 8].max()):6.0f} {np.degrees(log[:, 9].max()):6.0f} "
        f"{log[:, 14].min():7.2f} {log[:, 14].max():6.2f} {log[:, 15].max():7.2f} "
        f"{100 * at_bound:7.1f} {100 * log[:, 16].mean():8.1f}"
    )


HEADER = (
    f"{'phase':12} {'mean [m]':>8} {'max [m]':>8} {'m/s':>8} {'tilt':>6} {'asked':>6} "
    f"{'scale':>7} {'to':>6} {'m/s^2':>7} {'bound %':>7} {'not mpc %':>8}"
)


class Flyer:
    """Flies the courses one after the other."""

    def __init__(self, pilot: Pilot, executor: Any, *, patience: float, short: bool) -> None:
        self._pilot, self._executor, self._patience = pilot, executor, patience
        self._short = short

    def fly(self) -> list[Phase]:
        """Fly once, from the ground to disarmed; raises ``TimeoutError``."""
        ground = Phase("ground", lambda pilot: None, 3.0)
        self._spin(self._pilot.engage, until=lambda answer: answer.accepted)
        self._spin(self._pilot.arm, until=lambda answer: self._pilot.engaged)
        self._pass(ground)
        flown = [ground]
        for phase in course(short=self._short):
            asked = phase.ask(self._pilot)
            if asked is not None and not asked.accepted:
                self._spin(lambda phase=phase: phase.ask(self._pilot), until=lambda r: r.accepted)
            self._pass(phase)
            flown.append(phase)
            if not self._pilot.engaged and phase.name != "land":
                print(f"  released during {phase.name}", flush=True)
                return flown
        self._spin(lambda: None, until=lambda _: not self._pilot.engaged)
        print("  disarmed by itself", flush=True)
        return flown

    def _pass(self, phase: Phase) -> None:
        began_ns = self._pilot.now_ns
        while self._pilot.now_ns - began_ns < phase.seconds * 1e9:
            self._pilot.listen(self._executor)
            for odometry, window, tick in self._pilot.ticks():
                line = row(odometry, window, tick, began_ns)
                if line[0] >= phase.settled:
                    phase.rows.append(line)

    def _spin(self, ask: Callable[[], Any], *, until: Callable[[Any], bool]) -> None:
        """Ask every two seconds until the answer is right."""
        give_up, asked_ns, answer = time.monotonic() + self._patience, None, None
        while answer is None or not until(answer):
            if time.monotonic() > give_up:
                raise TimeoutError(getattr(answer, "text", "no odometry from PX4"))
            self._pilot.listen(self._executor)
            for odometry, _, _ in self._pilot.ticks():
                self._pilot.home = odometry.p_WB
            now_ns = self._pilot.now_ns
            if now_ns and (asked_ns is None or now_ns - asked_ns > 2_000_000_000):
                asked_ns, answer = now_ns, ask() or Reply(accepted=True, text="")
                if not answer.accepted:
                    print(f"  {answer.text}", flush=True)


def main() -> int:
    """Fly, print a table a flight, and keep the logs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--config", action="append", default=[], metavar="FILE")
    parser.add_argument("--set", action="append", default=[], dest="assignments", metavar="N.P=V")
    parser.add_argument("--bridge", choices=tuple(BRIDGES), default="px4")
    parser.add_argument("--flights", type=int, default=1)
    parser.add_argument("--short", action="store_true", help="take off, hover for 4 s and land")
    parser.add_argument("--out", type=Path, help="folder for a CSV file a flight")
    parser.add_argument("--patience", type=float, default=120.0, help="seconds for PX4 to answer")
    options = parser.parse_args()
    made = ["reference.mode=on_request", "mpc.lockstep=true", "reference.trajectory=lemniscate"]
    config = files.load(options.config, [*made, *options.assignments], schema=SCHEMA)
    rclpy.init()
    node, executor = rclpy.create_node("fly_px4"), SingleThreadedExecutor()
    executor.add_node(node)
    pilot = Pilot(config, node, BRIDGES[options.bridge])
    flyer = Flyer(pilot, executor, patience=options.patience, short=options.short)
    bound = min(pilot.mpc.omega_max) - 1e-6
    for number in range(options.flights):
        print(f"flight {number + 1}", flush=True)
        phases = flyer.fly()
        print(HEADER)
        for phase in phases:
            print(describe(phase.name, phase.rows, bound) if phase.rows else f"{phase.name}: -")
        sys.stdout.flush()
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            rows = [each for phase in phases for each in phase.rows]
            path = options.out / f"flight_{number + 1}.csv"
            np.savetxt(path, rows, delimiter=",", header=",".join(COLUMNS), comments="")
    return 0


if __name__ == "__main__":
    sys.exit(main())

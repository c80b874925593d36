# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Take off and land in MuJoCo, which simulates the contact with the ground.

python bench/contacts.py --out runs/contacts

Each case takes off, hovers, and lands on request; one flies a lemniscate in between. As a landing
is no faster than 1 m/s, a touchdown at 1.5 m/s is a reference that sinks at that speed through the
ground. Slopes, decks and loads are not configured in the MPC. A row has: crash, that is, contact
of hull or rotors; the mean position error in the air and after the request to land; the largest
tilt in the air and after contact, and the final tilt; the touchdown speed; the time from touchdown
until the motors idle, and until the reference ends the landing; bouncing and sliding distances.
docs/howto/contacts.md.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from markdown_table import markdown_table

from quad_mpc_ros import load_config
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.plants.mujoco.plant import MujocoPlant
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.references.configured import joined_trajectory
from quad_mpc_ros.references.director import GROUND, LANDING, Reply
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.references.path import Straight
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS
from quad_mpc_ros.simulation.sensors import OdometryStream

Request = Callable[[LiveReference, int], Reply]

COMMON = ("simulator.plant=mujoco", "reference.mode=on_request", "reference.takeoff_height=1.2")
SLOPE = f"simulator.mujoco.ground.slope={math.radians(10.0)}"
LOAD = ("simulator.mujoco.payload.mass=0.0793786", "simulator.mujoco.payload.cable_length=0.5")
NARROW = ("simulator.mujoco.gear.length=0.06", "simulator.mujoco.gear.width=0.06")
HOVER = (
    "simulator.initial_throttle=0.2923008",
    "reference.mode=at_once",
    "reference.trajectory=hover",
    "reference.height=1.5",
)
# Heaving with 0.3 m/s at most: 0.239 m at 0.2 Hz.
HEAVE = (
    "simulator.mujoco.deck.size=[3.0,3.0]",
    "simulator.mujoco.deck.position=[0.0,0.0,0.3]",
    "simulator.mujoco.deck.heave_amplitude=0.2387",
    "simulator.mujoco.deck.heave_frequency=0.2",
    "simulator.initial_position=[0.0,0.0,1.5]",
    *HOVER,
)
ROCK = (
    f"simulator.mujoco.deck.roll_amplitude={math.radians(5.0)}",
    f"simulator.mujoco.deck.pitch_amplitude={math.radians(5.0)}",
    "simulator.mujoco.deck.rock_frequency=0.25",
    "simulator.mujoco.deck.pitch_phase=1.0",
)
SINKING = 1.5  # m/s
IDLE, PERIOD = 0.02, 0.02  # a throttle below is that of idle motors; from command to command [s]
NOISE = (
    "simulator.position_noise=0.01",
    "simulator.velocity_noise=0.05",
    f"simulator.attitude_noise={math.radians(0.5)}",
    "simulator.rate_noise=0.02",
)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A flight: parameters, requests with their times [s], and duration [s]."""

    assignments: tuple[str, ...] = ()
    start: float = math.inf
    sinks: bool = False
    land: float = 6.0
    duration: float = 14.0


def _cases() -> dict[str, Case]:
    sinking = (
        "simulator.initial_position=[0.0,0.0,1.5]",
        f"simulator.initial_velocity=[0.0,0.0,{-SINKING}]",
        "simulator.initial_throttle=0.2923008",
        "reference.mode=at_once",
    )
    fast = {"sinks": True, "land": 0.0, "duration": 8.0}
    return {
        "flat": Case(),
        "flat, noise": Case(assignments=NOISE),
        "lemniscate, flat": Case(start=4.0, land=14.0, duration=22.0),
        "slope 10 degrees": Case(assignments=(SLOPE,)),
        "slope 10 degrees, noise": Case(assignments=(SLOPE, *NOISE)),
        "slope 10 degrees, friction 0.3": Case(
            assignments=(SLOPE, "simulator.mujoco.contact.friction=0.3")
        ),
        "slope 20 degrees": Case(
            assignments=(f"simulator.mujoco.ground.slope={math.radians(20.0)}",)
        ),
        "touchdown 1.5 m/s": Case(assignments=sinking, **fast),
        "touchdown 1.5 m/s, elastic gear": Case(
            assignments=(*sinking, "simulator.mujoco.contact.damping_ratio=0.2"), **fast
        ),
        "touchdown 1.5 m/s, slope 10 degrees": Case(assignments=(*sinking, SLOPE), **fast),
        "deck heaving 0.3 m/s": Case(assignments=HEAVE, land=2.0),
        "deck rocking 5 degrees": Case(
            assignments=(*HEAVE, *ROCK, "simulator.mujoco.deck.heave_amplitude=0.0"), land=2.0
        ),
        "deck rocking 5 degrees, heaving 0.3 m/s": Case(assignments=(*HEAVE, *ROCK), land=2.0),
        "deck rocking and heaving, noise": Case(assignments=(*HEAVE, *ROCK, *NOISE), land=2.0),
        "deck rocking 10 degrees at 0.5 Hz": Case(
            assignments=(
                *HEAVE,
                *ROCK,
                "simulator.mujoco.deck.heave_amplitude=0.0",
                f"simulator.mujoco.deck.roll_amplitude={math.radians(10.0)}",
                "simulator.mujoco.deck.rock_frequency=0.5",
            ),
            land=2.0,
        ),
        "deck heaving 0.75 m/s at 0.5 Hz": Case(
            assignments=(*HEAVE, "simulator.mujoco.deck.heave_frequency=0.5"), land=2.0
        ),
        "slope 20 degrees, friction 0.3": Case(
            assignments=(
                f"simulator.mujoco.ground.slope={math.radians(20.0)}",
                "simulator.mujoco.contact.friction=0.3",
                "simulator.initial_position=[0.0,0.0,1.5]",
                *HOVER,
            ),
            land=2.0,
        ),
        "wind 6 m/s": Case(assignments=("simulator.wind=[6.0,0.0,0.0]",)),
        "wind 6 m/s, gear of 6 cm, noise": Case(
            assignments=("simulator.wind=[6.0,0.0,0.0]", *NARROW, *NOISE)
        ),
        "slope 25 degrees, gear of 6 cm": Case(
            assignments=(f"simulator.mujoco.ground.slope={math.radians(25.0)}", *NARROW)
        ),
        "load of 20 %": Case(assignments=LOAD, duration=18.0),
        "load of 20 %, lemniscate": Case(assignments=LOAD, start=5.0, land=15.0, duration=26.0),
        "load of 20 %, noise": Case(assignments=(*LOAD, *NOISE), duration=18.0),
    }


CASES = _cases()


@dataclass
class Outcome:
    """Results of a flight; lengths in m, angles in degrees, times in s, speeds in m/s."""

    crashed: str = "no"
    errors: list[float] = field(default_factory=list)
    errors_landing: list[float] = field(default_factory=list)
    tilt_in_air: float = 0.0
    tilt_on_ground: float = 0.0
    tilt_at_end: float = math.nan
    met_ground: float = math.nan
    met_at: float = math.nan
    idle_after: float = math.nan
    noticed_after: float = math.nan
    bounced: float = 0.0
    moved: float = math.nan
    idles: bool = False
    first_contact: np.ndarray | None = None

    def cells(self) -> dict[str, str]:
        """Return the result as a row of a table."""
        return {
            "crashed": self.crashed,
            "mean error [m]": f"{_mean(self.errors):.3f}",
            "landing [m]": f"{_mean(self.errors_landing):.3f}",
            "tilt in air [°]": f"{self.tilt_in_air:.1f}",
            "after contact": f"{self.tilt_on_ground:.1f}",
            "at end": f"{self.tilt_at_end:.1f}",
            "met at [m/s]": _shown(self.met_ground),
            "idle after [s]": _shown(self.idle_after) if self.idles else "never",
            "noticed after [s]": _shown(self.noticed_after),
            "bounced [cm]": f"{100.0 * self.bounced:.1f}",
            "slid [cm]": _shown(100.0 * self.moved),
        }


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan


def _shown(value: float) -> str:
    return "never" if math.isnan(value) else f"{value:.2f}"


class Flight:
    """A case as it is flown, odometry by odometry."""

    def __init__(self, config: FlightConfig, case: Case) -> None:
        self.case = case
        self.plant = MujocoPlant(config.simulator)
        self.controller: Controller = warmed_up(config.mpc)
        self.stream = OdometryStream(
            self.plant, config.simulator, start_stamp_ns=SIMULATION_START_NS
        )
        trajectory = joined_trajectory(config.reference)
        if case.sinks:
            path = Straight(self.plant.state.p_WB, v_WB_W=np.array([0.0, 0.0, -SINKING]))
            trajectory = FlatTrajectory(path, config.reference, yaw=0.0)
        self.reference = LiveReference(
            config.reference, trajectory, joined=lambda: joined_trajectory(config.reference)
        )
        self.requests: list[tuple[float, Request]] = []
        if not case.sinks:
            self.requests.append((case.land, LiveReference.land))
        if config.reference.mode == "on_request":
            self.requests.append((0.5, LiveReference.take_off))
        if math.isfinite(case.start):
            self.requests.append((case.start, LiveReference.start))
        self.outcome = Outcome()
        self._speed = math.nan

    def fly(self) -> Outcome:
        """Fly to the end."""
        while (sent := self.stream.step()) is not None:
            now_ns = sent.odometry.stamp_ns
            seconds = 1e-9 * (now_ns - SIMULATION_START_NS)
            self.reference.observe(sent.odometry)
            for request in [each for each in self.requests if each[0] <= seconds]:
                self.requests.remove(request)
                reply = request[1](self.reference, now_ns)
                if not reply.accepted:
                    print(f"  refused at {seconds:.1f} s: {reply.text}", file=sys.stderr)
            window = self.reference.window(now_ns)
            assert window is not None
            self.controller.receive_reference(window, now_ns=now_ns)
            tick = self.controller.receive_odometry(sent.odometry, now_ns=now_ns)
            self.reference.set_ground_state(self.controller.ground_state)
            throttle = 0.0
            if tick is not None and tick.command is not None:
                self.plant.apply(tick.command)
                throttle = tick.command.throttle
            mode = self.reference.mode(now_ns)
            self._judge(seconds, window.p_WB[0], mode=mode, throttle=throttle)
        return self.outcome

    def _judge(self, seconds: float, wanted: np.ndarray, *, mode: str, throttle: float) -> None:
        """Record the true state of the vehicle and its contacts."""
        out, state, touching = self.outcome, self.plant.state, self.plant.scene.touched()
        broken = sorted(part for part in touching if not part.startswith("foot"))
        if broken and out.crashed == "no":
            out.crashed = f"{broken[0].rstrip('0123456789')} at {seconds:.1f} s"
        tilt = math.degrees(math.acos(min(max(state.R_WB[2, 2], -1.0), 1.0)))
        error = float(np.linalg.norm(wanted - state.p_WB))
        landing = seconds >= self.case.land
        out.tilt_at_end = tilt
        if mode not in (GROUND, LANDING) and seconds > 2.5 and not self.case.sinks:
            out.errors.append(error)
        if not touching and math.isnan(out.met_at):
            out.tilt_in_air = max(out.tilt_in_air, tilt) if seconds > 1.0 else 0.0
            if landing and (mode == LANDING or self.case.sinks):
                out.errors_landing.append(error)
                self._speed = float(np.linalg.norm(self.plant.v_WB_W))
        if landing and touching and math.isnan(out.met_at):
            out.met_at, out.met_ground = seconds, self._speed
            out.first_contact, out.idle_after = state.p_WB, 0.0
        if out.first_contact is not None:
            self._after_contact(seconds, mode=mode, throttle=throttle)
            if not touching:
                out.bounced = max(out.bounced, float(state.p_WB[2] - out.first_contact[2]))

    def _after_contact(self, seconds: float, *, mode: str, throttle: float) -> None:
        out, state = self.outcome, self.plant.state
        assert out.first_contact is not None
        out.moved = float(np.linalg.norm((state.p_WB - out.first_contact)[:2]))
        tilt = math.degrees(math.acos(min(max(state.R_WB[2, 2], -1.0), 1.0)))
        out.tilt_on_ground = max(out.tilt_on_ground, tilt)
        out.idles = throttle <= IDLE
        if not out.idles:
            out.idle_after = seconds + PERIOD - out.met_at
        if mode == GROUND and math.isnan(out.noticed_after):
            out.noticed_after = seconds - out.met_at


def flown(name: str, *, assignments: Sequence[str] = ()) -> Outcome:
    """Fly a case, with further assignments."""
    case = CASES[name]
    given = (*COMMON, f"simulator.duration={case.duration}", *case.assignments, *assignments)
    config = load_config("vehicles/paper", assignments=("mpc.lockstep=true", *given))
    return Flight(config, case).fly()


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly the cases and write a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("runs", "contacts"))
    parser.add_argument("--only", nargs="*", choices=[*CASES], default=[*CASES])
    parser.add_argument("--set", nargs="*", default=[], metavar="NODE.PARAM=VALUE", dest="given")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for name in options.only:
        outcome = flown(name, assignments=options.given)
        rows.append({"flight": name, **outcome.cells()})
        print(" | ".join(map(str, rows[-1].values())), file=sys.stderr, flush=True)
    with (options.out / "flights.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=[*rows[0]])
        writer.writeheader()
        writer.writerows(rows)
    print(markdown_table([*rows[0]], [list(row.values()) for row in rows]))
    return 0


if __name__ == "__main__":
    sys.exit(main())

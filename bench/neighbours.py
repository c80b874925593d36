# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly vehicles that share their plans: antipodal goals on a circle, and Luis' random goals.

    python -P bench/neighbours.py circle [--trials 100]
    python -P bench/neighbours.py box --vehicles 10 [--trials 50]

Circle: eight vehicles on a circle of 4 m radius change places with those opposite; 10 % of the
plans are lost, and they come 50 ms late. Box (Luis, Vukosavljev, Schoellig, RA-L 2020): starts and
goals at random in 3 m by 3 m by 2 m from z 0.2 m, distance 0.3 m with heights counted half,
1 m/s^2, 20 s, arrival within 0.1 m. All vehicles of a trial fly in turns, each with a controller
and a plant of its own.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.extras.obstacles.world import ObstacleWorld
from quad_mpc_ros.messages.obstacle_messages import TimedPath
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from fixtures.windows import window_through


@dataclass
class Radio:
    """The last plan of each that has come, some of them never."""

    lost: float
    late_ns: int
    rng: np.random.Generator
    sent: list[list[tuple[int, Plan]]] = field(default_factory=list)

    def send(self, number: int, plan: Plan, now_ns: int) -> None:
        """Send a plan to all, unless it is lost."""
        if self.rng.random() >= self.lost:
            self.sent[number].append((now_ns + self.late_ns, plan))

    def received(self, number: int, now_ns: int) -> Plan | None:
        """Return the newest plan of a vehicle that has come by now."""
        come = [plan for at_ns, plan in self.sent[number][-8:] if at_ns <= now_ns]
        return come[-1] if come else None


def vehicle(
    number: int,
    *,
    start: Array,
    goal: Array,
    config: MpcConfig,
    radio: Radio,
    radius: float,
    duration: float,
    guided_us: list[float],
    acceleration: float,
) -> Iterator[LoopStep]:
    """Fly one of them, a step at a time."""
    names = {other: f"uav{other}" for other in range(len(radio.sent)) if other != number}
    own = config.updated({"obstacles.neighbours": tuple(names.values())})
    world = ObstacleWorld(own.obstacles)
    guide = ObstacleAvoidance(own, world, radius=radius)
    controller = Controller(config, guide=guide)
    simulator = SimulatorConfig.build(
        {
            "rate_time_constant": 0.07,
            "thrust_time_constant": 0.04,
            "command_delay": 0.02,
            "duration": duration,
            "initial_position": tuple(start),
            "initial_throttle": 0.2923,
        }
    )

    def law(odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        world.receive_odometry(odometry)
        for other, name in names.items():
            plan = radio.received(other, odometry.stamp_ns)
            if plan is not None:
                world.receive_neighbour(name, path_of(plan))
        held = reference(start, goal, acceleration=acceleration, stamp_ns=odometry.stamp_ns)
        began = time.thread_time()
        tick = controller.step(odometry, held)
        guided_us.append(1e6 * (time.thread_time() - began))
        if tick is not None and tick.plan is not None:
            radio.send(number, tick.plan, odometry.stamp_ns)
        failures[number] = tick.stats.solver_failures if tick is not None else 0
        return None if tick is None else tick.command

    failures = radio.__dict__.setdefault("failures", {})
    yield from fly(mpc=config, simulator=simulator, controller=law)


def path_of(plan: Plan) -> TimedPath:
    """Return a plan as its message has it."""
    times_ns = plan.stamp_ns + round(1e9 * plan.step) * np.arange(len(plan.p_WB))
    return TimedPath(stamp_ns=plan.stamp_ns, frame_id="odom", times_ns=times_ns, p=plan.p_WB)


def reference(start: Array, goal: Array, *, acceleration: float, stamp_ns: int) -> ReferenceWindow:
    """Return the straight way from rest to rest in the least time, from a stamp on."""
    length = max(float(np.linalg.norm(goal - start)), 1e-6)
    half = np.sqrt(length / acceleration)
    seconds = np.arange(0.0, 2.01, 0.1)
    t = np.clip(1e-9 * (stamp_ns - SIMULATION_START_NS) + seconds, 0.0, 2.0 * half)
    rising = 0.5 * acceleration * np.minimum(t, half) ** 2
    falling = 0.5 * acceleration * np.maximum(2.0 * half - t, 0.0) ** 2
    along = np.where(t < half, rising, length - falling) / length
    places = start + along[:, None] * (goal - start)
    return window_through(seconds, places, stamp_ns=stamp_ns)


def trial(
    starts: Array,
    goals: Array,
    *,
    config: MpcConfig,
    radius: float,
    duration: float,
    lost: float,
    late_ns: int,
    seed: int,
    acceleration: float,
) -> dict[str, Any]:
    """Fly all from starts (n, 3) to goals (n, 3); return smallest distance and arrivals."""
    radio = Radio(lost, late_ns, np.random.default_rng(seed), [[] for _ in starts])
    took: list[float] = []
    flights = [
        vehicle(
            number,
            start=start,
            goal=goal,
            config=config,
            radio=radio,
            radius=radius,
            duration=duration,
            guided_us=took,
            acceleration=acceleration,
        )
        for number, (start, goal) in enumerate(zip(starts, goals, strict=True))
    ]
    nearest, arrived_s, speeds = np.inf, np.inf, []
    for tick, steps in enumerate(zip(*flights, strict=False)):
        p = np.array([step.truth.p_WB for step in steps]) * [1.0, 1.0, 0.5]
        apart = np.linalg.norm(p[:, None] - p, axis=2) + 1e3 * np.eye(len(p))
        nearest = min(nearest, float(apart.min()))
        R_WB = so3.rotation_from_quaternion_xyzw([step.truth.q_WB_xyzw for step in steps])
        v_WB_B = np.array([step.truth.v_WB_B for step in steps])
        speeds.append((R_WB @ v_WB_B[..., None])[..., 0])
        away = np.linalg.norm([s.truth.p_WB for s in steps] - goals, axis=1)
        if away.max() < 0.1:
            arrived_s = 0.02 * tick
            break
    return {
        "nearest": nearest,
        "arrived": int((away < 0.1).sum()),
        "seconds": arrived_s,
        "hardest": float(np.abs(np.diff(speeds, axis=0)[..., :2]).max() / 0.02),
        "step_us": float(np.median(took)),
        "p99_us": float(np.percentile(took, 99)),
        "failures": sum(radio.__dict__["failures"].values()),
    }


def circle(seed: int) -> tuple[Array, Array]:
    """Return starts and goals on a circle of 4 m radius, a centimetre off at random."""
    angles = 2.0 * np.pi * np.arange(8) / 8.0
    places = np.column_stack([4.0 * np.cos(angles), 4.0 * np.sin(angles), np.full(8, 1.5)])
    off = 0.01 * np.random.default_rng(seed).normal(size=(8, 3)) if seed else 0.0
    return places + off, np.roll(places, 4, axis=0)


def box(seed: int, count: int) -> tuple[Array, Array]:
    """Return starts and goals at random, those of each kind apart."""
    rng = np.random.default_rng(seed)

    def places() -> Array:
        kept = np.zeros((0, 3))
        while len(kept) < count:
            place = np.array([0.0, 0.0, 0.2]) + rng.uniform(0.0, [3.0, 3.0, 2.0])
            apart = np.linalg.norm((kept - place) * [1.0, 1.0, 0.5], axis=1)
            if (apart > 0.35).all():
                kept = np.vstack([kept, place])
        return kept

    return places(), places()


def main() -> int:
    """Fly the trials."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=("circle", "box"))
    parser.add_argument("--vehicles", type=int, default=10)
    parser.add_argument("--trials", type=int, default=10)
    given = parser.parse_args()
    common = {"obstacles.half_spaces": 8, "obstacles.floor": 0.0}
    if given.kind == "circle":
        config, radius, duration = MpcConfig().updated(common), 0.25, 20.0
        lost, late_ns, acceleration = 0.1, 50_000_000, 1.5
    else:
        tilt = {"limits.tilt_max": 0.1, "obstacles.margin": 0.02}
        config, radius, duration = MpcConfig().updated({**common, **tilt}), 0.15, 20.0
        lost, late_ns, acceleration = 0.0, 0, 1.0
    warmed_up(config)
    good = 0
    for seed in range(given.trials):
        starts, goals = circle(seed) if given.kind == "circle" else box(seed, given.vehicles)
        result = trial(
            starts,
            goals,
            config=config,
            radius=radius,
            duration=duration,
            lost=lost,
            late_ns=late_ns,
            seed=seed,
            acceleration=acceleration,
        )
        fine = result["nearest"] >= 2.0 * radius and result["arrived"] == len(starts)
        good += fine
        print(seed, "good" if fine else "BAD", {k: round(v, 3) for k, v in result.items()})
        sys.stdout.flush()
    print(f"{good} of {given.trials} trials without collision in which all arrive")
    return 0


if __name__ == "__main__":
    sys.exit(main())

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The sudden obstacles of IPC: a pillar that slides into the way of a vehicle in flight.

    python -P bench/sudden_obstacles.py [--plant ideal|default] [--runs 10] [--out FILE]

Liu, Ren and Zhang, "Integrated planning and control for quadrotor navigation in presence of
suddenly appearing objects and disturbances", RA-L 2024, section IV-A: a vehicle flies ahead at
v_f; when it is d_t from the front of a pillar of 0.2 m by 0.2 m, the pillar slides into its way.
It is seen as a cloud of points 0.1 m apart. As in their published program (``fast_avoid.cpp``) it
is seen beside the line, 0.5 m from it, when it begins, and on the line at the next tick of 10 Hz,
whose phase is that of the seed; the last cloud seen is what is hit. With ``--at-once`` it is on
the line when it begins, which is what a point mass's table is about.

A run succeeds if no point comes nearer to the vehicle's centre than 0.25 m across and the
velocity and acceleration stay within 10 m/s and 20 m/s^2 (10 downwards) along each axis.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.extras.obstacles.moving import MovingPoints
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

RADIUS, SPEED, ACCELERATION, DOWN = 0.25, 10.0, 20.0, 10.0
FRONT, WIDTH, HEIGHT = 6.9, 0.2, 3.0  # m
DISTANCES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
SPEEDS = tuple(0.5 * k for k in range(1, 21))
_PERIOD_NS = 100_000_000
_TOLERANCE = 0.05  # of speed and acceleration: what an estimate of them from samples is off by

# A vehicle of IPC's bounds: thrust for 20 m/s^2 to any side, weights that follow closely.
FAST: dict[str, Any] = {
    "obstacles.half_spaces": 8,
    "obstacles.margin": 0.25,
    "advanced.obstacles.margin_growth": 0.005,
    "obstacles.acceleration": 20.0,
    "obstacles.speed_max": SPEED,
    "limits.tilt_max": 1.25,
    "throttle_max": 0.55,
}
AT_ONCE: dict[str, Any] = {
    "rate_time_constant": 0.0,
    "thrust_time_constant": 0.0,
    "R": (0.0, 0.001, 0.001, 0.001),
    "omega_max": (60.0, 60.0, 10.0),
    "horizon_steps": 16,
    "horizon_step": 0.03,
}


def point_mass_speeds(distance: float) -> float:
    """Return the highest of the speeds with which a point mass can keep clear.

    It brakes and swerves at once, as hard as it may along each axis.
    """
    best = 0.0
    for speed in SPEEDS:
        t = np.arange(0.0, 1.0, 1e-4)
        stopping = np.minimum(t, speed / ACCELERATION)
        x = speed * stopping - 0.5 * ACCELERATION * stopping**2
        y = 0.5 * ACCELERATION * t**2
        ahead, beside = np.maximum(distance - x, 0.0), np.maximum(y - 0.5 * WIDTH, 0.0)
        inside = np.hypot(ahead, beside) < RADIUS - 1e-9
        if not inside.any():
            best = speed
    return best


class SuddenPillar:
    """A pillar that appears beside the line, and is on it at the next tick of 10 Hz."""

    spacing = 0.1

    def __init__(self, *, distance: float, phase_ns: int, at_once: bool) -> None:
        self._distance, self._phase_ns, self._at_once = distance, phase_ns, at_once
        self.seen, self.revision = np.zeros((0, 3)), 0
        self._stage = 0

    def move(self, p_WB: Array, stamp_ns: int) -> None:
        """Take where the vehicle is, and appear when it is near enough."""
        if self._stage == 0 and p_WB[0] >= FRONT - self._distance:
            ticks = (stamp_ns - self._phase_ns) // _PERIOD_NS + 1
            self._on_line_ns = self._phase_ns + ticks * _PERIOD_NS
            self._show(p_WB[1] + (0.0 if self._at_once else 0.5))
            self._stage = 2 if self._at_once else 1
        elif self._stage == 1 and stamp_ns >= self._on_line_ns:
            self._show(p_WB[1])
            self._stage = 2

    def _show(self, y: float) -> None:
        across = np.array([-0.1, 0.0, 0.1])
        axes = FRONT + 0.5 * WIDTH + across, y + across, np.arange(0.0, HEIGHT + 0.05, 0.1)
        self.seen = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self.revision += 1

    def points(self, stamp_ns: int, *, near: Array, radius: float) -> Array:
        """Return the points of the pillar."""
        return self.seen

    def moving(self, stamp_ns: int, *, near: Array, radius: float) -> MovingPoints:
        """Return nothing: a cloud has no speeds."""
        return MovingPoints.none()

    def age(self, stamp_ns: int) -> float:
        """Return the age of a map."""
        return 0.0


class Straight:
    """A path ahead at a constant speed."""

    periodic = False
    duration = 1e3

    def __init__(self, speed: float) -> None:
        self._speed = speed

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]."""
        seconds = np.asarray(seconds, dtype=float)
        rest, v = np.zeros((len(seconds), 3)), np.array([self._speed, 0.0, 0.0])
        start = np.array([FRONT - 3.0 - 0.4 * self._speed - 0.5, 0.0, 1.0])
        return PathSamples(
            p_WB=start + seconds[:, None] * v, v_WB_W=rest + v, a_WB_W=rest, j_WB_W=rest
        )


@dataclass(frozen=True, kw_only=True)
class Run:
    """A cell of the table, and which of its runs."""

    distance: float
    speed: float
    seed: int
    plant: str
    rate: float
    at_once: bool
    changes: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a run: the smallest distance to a point, and details."""

    distance: float
    speed: float
    seed: int
    nearest_m: float
    fastest: float
    hardest: float
    failures: int
    fallbacks: int
    arrived: bool
    step_us: float

    @property
    def succeeded(self) -> bool:
        """Whether distance and limits held."""
        within = self.fastest <= SPEED * (1.0 + _TOLERANCE)
        return (
            self.nearest_m >= RADIUS
            and within
            and self.hardest <= 1.0 + _TOLERANCE
            and self.failures == 0
            and self.arrived
        )


def configured(run: Run) -> tuple[MpcConfig, SimulatorConfig]:
    """Return the controller and the plant of a run."""
    lags = AT_ONCE if run.plant == "ideal" else {}
    delay = 0.0 if run.plant == "ideal" else 0.02
    mpc = MpcConfig().updated(
        {**FAST, **lags, "input_delay": delay, "control_rate": run.rate, **dict(run.changes)}
    )
    # The true vehicle's lags are the modelled ones.
    simulator = SimulatorConfig.build(
        {
            "rate_time_constant": mpc.rate_time_constant,
            "thrust_time_constant": mpc.thrust_time_constant,
            "command_delay": delay,
            "odom_rate": run.rate,
            "duration": 13.0 / run.speed + 2.0,
            "seed": run.seed,
        }
    )
    return mpc, simulator


def flown(run: Run) -> Iterator[tuple[Any, SuddenPillar, Array]]:
    """Fly a run; yield each step, what is seen by then, and the nearest of it across."""
    mpc, simulator = configured(run)
    phase_ns = int(np.random.default_rng(run.seed).integers(0, _PERIOD_NS))
    pillar = SuddenPillar(distance=run.distance, phase_ns=phase_ns, at_once=run.at_once)
    guide = ObstacleAvoidance(mpc, pillar, radius=RADIUS)
    warmed_up(mpc)
    steps = fly(
        mpc=mpc,
        simulator=simulator,
        reference=ReferenceConfig(),
        trajectory=Straight(run.speed),
        controller=Controller(mpc, guide=guide),
        on_reference=True,
    )
    for step in steps:
        yield step, pillar, step.truth.p_WB
        pillar.move(step.truth.p_WB, step.odometry.stamp_ns)


def outcome(run: Run) -> Outcome:
    """Fly a run and return the result."""
    times, velocities, nearest, failures, fallbacks, took = [], [], np.inf, 0, 0, []
    before, arrived = None, False
    for step, pillar, p_WB in flown(run):
        R_WB = so3.rotation_from_quaternion_xyzw(step.truth.q_WB_xyzw)
        times.append(step.truth.stamp_ns * 1e-9)
        velocities.append(R_WB @ step.truth.v_WB_B)
        if len(pillar.seen):
            if before is None:
                before = p_WB
            between = before + np.linspace(0.0, 1.0, 11)[:, None] * (p_WB - before)
            across = between[:, None, :2] - pillar.seen[None, ::4, :2]
            nearest = min(nearest, float(np.linalg.norm(across, axis=2).min()))
        before = p_WB if len(pillar.seen) else None
        if step.tick is not None:
            failures = step.tick.stats.solver_failures
            fallbacks = step.tick.stats.fallbacks
            took.append(step.tick.stats.step_time_us)
        if p_WB[0] >= 10.0:
            arrived = True
            break
    v = np.array(velocities)
    a = np.diff(v, axis=0) / np.diff(times)[:, None]
    bounds = np.where(a[:, 2] < 0.0, DOWN, ACCELERATION)
    hardest = max(
        float(np.abs(a[:, :2]).max()) / ACCELERATION, float((abs(a[:, 2]) / bounds).max())
    )
    return Outcome(
        distance=run.distance,
        speed=run.speed,
        seed=run.seed,
        nearest_m=nearest,
        fastest=float(np.abs(v).max()),
        hardest=hardest,
        failures=failures,
        fallbacks=fallbacks,
        arrived=arrived,
        step_us=float(np.median(took)),
    )


def table(outcomes: list[Outcome]) -> str:
    """Return successes by cell, point mass's limit beside it."""
    lines = ["d_t    point mass  " + " ".join(f"{v:4.1f}" for v in SPEEDS)]
    able = good = 0
    for distance in DISTANCES:
        limit, cells = point_mass_speeds(distance), []
        for speed in SPEEDS:
            own = [o for o in outcomes if o.distance == distance and o.speed == speed]
            won = sum(o.succeeded for o in own)
            cells.append(f"{won:2d}/{len(own):<2d}" if own else "  . ")
            if speed <= limit and own:
                able, good = able + 1, good + (won >= 0.9 * len(own))
        lines.append(f"{distance:3.1f} m  {limit:4.1f} m/s   " + "".join(cells))
    failures = sum(o.failures for o in outcomes)
    lines.append(f"{good} of {able} cells that a point mass can do; failed solves: {failures}")
    return "\n".join(lines)


def main() -> int:
    """Fly the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plant", choices=("ideal", "default"), default="ideal")
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--at-once", action="store_true")
    parser.add_argument("--distance", type=float, action="append")
    parser.add_argument("--speed", type=float, action="append")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    changes = tuple((k, json.loads(v)) for k, v in (each.split("=", 1) for each in given.set))
    runs = [
        Run(
            distance=distance,
            speed=speed,
            seed=seed,
            plant=given.plant,
            rate=given.rate,
            at_once=given.at_once,
            changes=changes,
        )
        for distance in given.distance or DISTANCES
        for speed in given.speed or SPEEDS
        for seed in range(given.runs)
    ]
    if given.jobs > 1:
        with ProcessPoolExecutor(given.jobs) as pool:
            outcomes = list(pool.map(outcome, runs, chunksize=4))
    else:
        outcomes = [outcome(run) for run in runs]
    print(table(outcomes))
    if given.out:
        given.out.write_text(json.dumps([vars(o) for o in outcomes]))
    return 0


if __name__ == "__main__":
    sys.exit(main())

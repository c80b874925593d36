# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly through a forest of pillars, sensed within 6 m: count the goals reached without contact.

    python -P bench/forest.py [--speed 5] [--flights 100] [--unknown]

40 m by 40 m by 5 m, 200 pillars 0.2 to 0.3 m wide and 1.5 to 4 m high at random; starts and
goals 35 m apart, 1.2 m high; default weights and lags. A flight arrives if it comes within 0.5 m
of the goal, and touches if a pillar's surface comes nearer to the centre than the radius.
``--unknown`` flies vehicles with random lags, delay and thrust that are not configured.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.extras.obstacles.moving import MovingPoints
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

RADIUS, SIDE, LENGTH, HEIGHT, SEEN = 0.25, 40.0, 35.0, 1.2, 6.0
_PERIOD_NS = 100_000_000
_SPACING = 0.1


class Forest:
    """Pillars; a sensor reports points within 6 m at 10 Hz, and reported points stay."""

    spacing = _SPACING

    def __init__(self, seed: int, *, clear: Array) -> None:
        """No pillar is near the positions ``clear`` (n, 2)."""
        rng = np.random.default_rng(seed)
        self.centres, self.halves, self.heights = np.zeros((0, 2)), np.zeros(0), np.zeros(0)
        while len(self.centres) < 200:
            centre = rng.uniform(-0.5 * SIDE, 0.5 * SIDE, size=2)
            half, height = 0.5 * rng.uniform(0.2, 0.3), rng.uniform(1.5, 4.0)
            if np.linalg.norm(clear - centre, axis=1).min() > 1.0:
                self.centres = np.vstack([self.centres, centre])
                self.halves = np.append(self.halves, half)
                self.heights = np.append(self.heights, height)
        self._surfaces = [
            _surface(c, half=h, height=z)
            for c, h, z in zip(self.centres, self.halves, self.heights, strict=True)
        ]
        self._seen = np.zeros(len(self.centres), dtype=bool)
        self._next_ns, self.revision = 0, 0

    def look(self, p_WB: Array, stamp_ns: int) -> None:
        """Measure if a measurement is due."""
        if stamp_ns < self._next_ns:
            return
        self._next_ns = stamp_ns + _PERIOD_NS
        new = np.linalg.norm(self.centres - p_WB[:2], axis=1) < SEEN
        if (new & ~self._seen).any():
            self.revision += 1
        self._seen |= new

    def points(self, stamp_ns: int, *, near: Array, radius: float) -> Array:
        """Return the points of the pillars seen so far that are near."""
        close = np.linalg.norm(self.centres - near[:2], axis=1) < radius + 1.0
        surfaces = [self._surfaces[k] for k in np.flatnonzero(close & self._seen)]
        return np.vstack(surfaces) if surfaces else np.zeros((0, 3))

    def moving(self, stamp_ns: int, *, near: Array, radius: float) -> MovingPoints:
        """Return nothing: pillars do not move."""
        return MovingPoints.none()

    def age(self, stamp_ns: int) -> float:
        """Return the age of a map."""
        return 0.0

    def distance(self, p_WB: Array) -> float:
        """Return the exact distance of a place to the nearest pillar's surface [m]."""
        across = np.maximum(np.abs(self.centres - p_WB[:2]) - self.halves[:, None], 0.0)
        above = np.maximum(p_WB[2] - self.heights, 0.0)
        return float(np.sqrt((across**2).sum(axis=1) + above**2).min())


def _surface(centre: Array, *, half: float, height: float) -> Array:
    """Return points of a pillar's sides and top, at most a tenth of a metre apart."""
    across = np.linspace(-half, half, int(np.ceil(2 * half / _SPACING)) + 1)
    up = np.linspace(0.0, height, int(np.ceil(height / _SPACING)) + 1)
    x, y, z = (axis.ravel() for axis in np.meshgrid(across, across, up, indexing="ij"))
    outside = (np.abs(x) > half - 1e-9) | (np.abs(y) > half - 1e-9) | (z > height - 1e-9)
    return np.stack([x + centre[0], y + centre[1], z], axis=1)[outside]


class Crossing:
    """A straight path that speeds up, cruises, and stops at the goal; at rest at both ends."""

    periodic = False

    def __init__(self, start: Array, goal: Array, *, speed: float) -> None:
        self._start, self._way = start, goal - start
        self._length = float(np.linalg.norm(self._way))
        self._ramp = speed / 2.5  # s: its mean acceleration is 2.5 m/s^2
        self._speed = speed
        self.duration = self._length / speed + self._ramp

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]."""
        t = np.clip(np.asarray(seconds, dtype=float), 0.0, self.duration)
        rising = np.minimum(t, self.duration - t) / self._ramp
        x = np.clip(rising, 0.0, 1.0)
        share = x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)
        slope = 140.0 * x**3 * (1.0 - x) ** 3 / self._ramp
        bend = 420.0 * x**2 * (1.0 - x) ** 2 * (1.0 - 2.0 * x) / self._ramp**2
        gone = self._ramp * x**5 * (7.0 - 14.0 * x + 10.0 * x**2 - 2.5 * x**3)
        ends = t > 0.5 * self.duration
        sign = np.where(ends, -1.0, 1.0)
        plain = self._speed * (gone + np.maximum(np.minimum(t, self.duration - t) - self._ramp, 0))
        along = np.where(ends, self._length - plain, plain)
        u = self._way / self._length
        return PathSamples(
            p_WB=self._start + along[:, None] * u,
            v_WB_W=(self._speed * share)[:, None] * u,
            a_WB_W=(self._speed * sign * slope)[:, None] * u,
            j_WB_W=(self._speed * bend)[:, None] * u,
        )


@dataclass(frozen=True, kw_only=True)
class Flight:
    """Result of a flight."""

    seed: int
    speed: float
    nearest_m: float
    away_m: float
    failures: int
    fallbacks: int
    around_share: float
    stopped_share: float
    step_p99_us: float
    guide_p99_us: float

    @property
    def touched(self) -> bool:
        """Whether it came nearer than the radius."""
        return self.nearest_m < RADIUS

    @property
    def arrived(self) -> bool:
        """Whether it ended at the goal."""
        return self.away_m < 0.5


def unknown_vehicle(seed: int) -> dict[str, Any]:
    """Return a plant of lags, delay, thrust and wind at random."""
    rng = np.random.default_rng(1000 + seed)
    return {
        "rate_time_constant": rng.uniform(0.02, 0.08),
        "thrust_time_constant": rng.uniform(0.02, 0.08),
        "command_delay": rng.uniform(0.005, 0.08),
        "mass_scale": 1.0 / rng.uniform(0.7, 1.3),
        "wind": (*rng.uniform(-4.0, 4.0, size=2), 0.0),
    }


def flown(seed: int, speed: float, unknown: bool, changes: dict[str, Any]) -> Flight:
    """Fly one start and goal."""
    import time

    rng = np.random.default_rng(seed)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    middle = rng.uniform(-1.5, 1.5, size=2)
    start = np.array([*(middle - 0.5 * LENGTH * ahead), HEIGHT])
    goal = np.array([*(middle + 0.5 * LENGTH * ahead), HEIGHT])
    forest = Forest(seed, clear=np.array([start[:2], goal[:2]]))
    mpc = MpcConfig().updated({"obstacles.half_spaces": 8, "obstacles.range": SEEN, **changes})
    path = Crossing(start, goal, speed=speed)
    simulator = SimulatorConfig.build(
        {
            "rate_time_constant": 0.07,
            "thrust_time_constant": 0.04,
            "command_delay": 0.02,
            **(unknown_vehicle(seed) if unknown else {}),
            "duration": path.duration + 12.0,
            "initial_position": tuple(start),
            "initial_throttle": 0.2923,
            "seed": seed,
        }
    )
    guide = ObstacleAvoidance(mpc, forest, radius=RADIUS)
    warmed_up(mpc)
    controller = Controller(mpc, guide=guide)
    inner, guided_us = guide.guide, []

    def timed(*arguments: Any) -> Any:
        began = time.perf_counter()
        result = inner(*arguments)
        guided_us.append(1e6 * (time.perf_counter() - began))
        return result

    guide.guide = timed  # type: ignore[method-assign]
    nearest, steps, states = np.inf, [], []
    away = np.inf
    for step in fly(
        mpc=mpc,
        simulator=simulator,
        reference=ReferenceConfig(),
        trajectory=path,
        controller=controller,
    ):
        p_WB = step.truth.p_WB
        forest.look(p_WB, step.odometry.stamp_ns)
        nearest = min(nearest, forest.distance(p_WB))
        if step.tick is not None:
            stats = step.tick.stats
            steps.append(stats.step_time_us)
            states.append(stats.avoidance)
        away = min(away, float(np.linalg.norm(p_WB - goal)))
        if nearest < RADIUS or away < 0.3:
            break
    return Flight(
        seed=seed,
        speed=speed,
        nearest_m=nearest,
        away_m=away,
        failures=stats.solver_failures,
        fallbacks=stats.fallbacks,
        around_share=states.count("around") / len(states),
        stopped_share=states.count("stopped") / len(states),
        step_p99_us=float(np.percentile(steps, 99)),
        guide_p99_us=float(np.percentile(guided_us, 99)),
    )


def main() -> int:
    """Fly them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--speed", type=float, default=5.0)
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--unknown", action="store_true")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    changes = {k: json.loads(v) for k, v in (each.split("=", 1) for each in given.set)}
    seeds = range(given.first, given.first + given.flights)
    rest = [given.speed] * len(seeds), [given.unknown] * len(seeds), [changes] * len(seeds)
    if given.jobs > 1:
        with ProcessPoolExecutor(given.jobs) as pool:
            flights = list(pool.map(flown, seeds, *rest))
    else:
        flights = [flown(*each) for each in zip(seeds, *rest, strict=True)]
    for flight in flights:
        if flight.touched or not flight.arrived or flight.failures:
            print(flight)
    print(
        f"{sum(f.arrived and not f.touched for f in flights)} of {len(flights)} arrive at "
        f"{given.speed:g} m/s, {sum(f.touched for f in flights)} touch, "
        f"{sum(f.failures for f in flights)} solves fail; nearest "
        f"{min(f.nearest_m for f in flights):.2f} m, step p99 "
        f"{np.median([f.step_p99_us for f in flights]):.0f} us, guide p99 "
        f"{np.median([f.guide_p99_us for f in flights]):.0f} us (medians)"
    )
    if given.out:
        given.out.write_text(json.dumps([vars(f) for f in flights]))
    return 0


if __name__ == "__main__":
    sys.exit(main())

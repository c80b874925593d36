# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Measure the cost of obstacle avoidance: the step with and without eight half-spaces; the map.

    python -P bench/obstacle_cost.py

The step is the estimate and :meth:`.mpc.Mpc.solve`, from states along a path around a pillar, each
computed with its corridor and without it, one after the other. The guide is timed as well, and the
map of 100,000 points about the vehicle with its grid, which the node makes in a thread of its own.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.mpc import Mpc, MpcStep
from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.extras.obstacles.moving import MovingPoints

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from fixtures.windows import window_through

_TICKS = 400


class Cloud:
    """Points that stand; a new revision each time it is asked to be seen again."""

    spacing = 0.05

    def __init__(self, points: Array) -> None:
        self._points, self.revision = points, 0

    def points(self, stamp_ns: int, *, near: Array, radius: float) -> Array:
        """Return the near points."""
        return self._points[np.linalg.norm(self._points - near, axis=1) <= radius]

    def moving(self, stamp_ns: int, *, near: Array, radius: float) -> MovingPoints:
        """Return nothing."""
        return MovingPoints.none()

    def age(self, stamp_ns: int) -> float:
        """Return the age of a map."""
        return 0.0

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Stay where it is: no odometry is reset here."""


def timed(call: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    """Return the CPU time of a call in this thread [us], and its result."""
    began = time.thread_time()
    result = call(*arguments)
    return 1e6 * (time.thread_time() - began), result


def step_of(estimator: DelayCompensation, mpc: Mpc) -> Callable[..., MpcStep]:
    """Return a function from odometry, window and corridor to a plan."""
    return lambda odometry, *flown: mpc.solve(estimator.predict(odometry), *flown)


def cloud(count: int) -> Array:
    """Return so many points of pillars' surfaces within 8 m, none on the line along x."""
    rng = np.random.default_rng(0)
    centres = rng.uniform(-8.0, 8.0, size=(40, 2))
    centres = np.vstack([centres[np.abs(centres[:, 1]) > 1.0], [4.0, 0.1]])
    which, angle = rng.integers(len(centres), size=count), rng.uniform(0.0, 2.0 * np.pi, count)
    across = 0.15 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.column_stack([centres[which] + across, rng.uniform(0.0, 3.0, count)])


def main() -> None:
    """Print the figures."""
    config = MpcConfig().updated({"obstacles.half_spaces": 8})
    obstacles = Cloud(cloud(100_000))
    guide = ObstacleAvoidance(config, obstacles, radius=0.25)
    within, without = (step_of(DelayCompensation(config), Mpc(config)) for _ in range(2))
    steps: list[tuple[float, float, float]] = []
    mapped_us: list[float] = []
    state, plan = np.zeros(6), None
    state[2], state[3] = 1.2, 2.0
    due: list[bool] = []
    guide.surroundings.wake = lambda: due.append(True)
    for tick in range(_TICKS):
        stamp_ns = 10**9 + 20_000_000 * tick
        start = np.array([2.0 * 0.02 * tick % 6.0, 0.0, 1.2])
        if start[0] < 0.02:
            state[:3], state[3:], plan = start, (2.0, 0.0, 0.0), None
        seconds = np.arange(0.0, 2.01, 0.05)
        line = start + seconds[:, None] * [2.0, 0.0, 0.0]
        window = window_through(seconds, line, stamp_ns=stamp_ns)
        seen = OdometrySample(
            stamp_ns=stamp_ns,
            p_WB=state[:3].copy(),
            q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
            v_WB_B=state[3:].copy(),
            w_WB_B=np.zeros(3),
        )
        if tick % 5 == 0:  # scans come with every fifth odometry
            obstacles.revision += 1
        took, guided = timed(guide.guide, seen, window, plan)
        if due:
            mapped_us.append(timed(guide.surroundings.update_map)[0])
            due.clear()
        if guided.corridor is None:
            state[:3] = start
            continue
        # By turns, so that each finds the processor's caches as the other does.
        if tick % 2:
            outside = timed(without, seen, guided.window)
        inside = timed(within, seen, guided.window, guided.corridor)
        if not tick % 2:
            outside = timed(without, seen, guided.window)
        plan = inside[1].plan
        if plan is not None:
            steps.append((took, inside[0], outside[0]))
            state[3:] = (plan.p_WB[2] - plan.p_WB[1]) / plan.step
            state[:3] += 0.02 * state[3:]
    guided_us, own, plain = np.array(steps)[10:].T
    print(f"{len(own)} steps with a corridor")
    for name, values in (
        ("guide", guided_us),
        ("step with 8 half-spaces", own),
        ("both", guided_us + own),
        ("step without", plain),
    ):
        p50, p99 = np.percentile(values, (50, 99))
        print(f"{name:24s} p50 {p50:6.0f} us, p99 {p99:6.0f} us")
    for name, values in (("step", own), ("guide and step", guided_us + own)):
        p50, p99 = np.percentile(values, (50, 99)) / np.percentile(plain, (50, 99))
        print(f"{name} over the step without: p50 {p50:.2f}, p99 {p99:.2f}")
    print(
        f"map and grid of 100,000 points, in a thread: p50 {np.median(mapped_us):.0f} us, "
        f"{1e-4 * np.median(mapped_us) * 10:.1f} % of a core at 10 Hz"
    )


if __name__ == "__main__":
    main()

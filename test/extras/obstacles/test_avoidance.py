# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Flights among obstacles: free references are kept, others are replanned or stopped."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from fixtures.obstacles import Standing, box
from fixtures.windows import window_through

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.qp_solver import QpSolver
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import SimulatorConfig

RADIUS = 0.25
CONFIG = MpcConfig().updated({"obstacles.half_spaces": 8})
PILLAR = box(np.array([4.0, 0.0, 1.5]), np.array([0.2, 0.2, 3.0]))


class Straight:
    """Along x at a constant speed, 1 m high."""

    periodic = False
    duration = 1e3

    def __init__(self, speed: float) -> None:
        self._speed = speed

    def at(self, seconds: Array) -> PathSamples:
        rest, v = np.zeros((len(seconds), 3)), np.array([self._speed, 0.0, 0.0])
        p = np.asarray(seconds)[:, None] * v + [0.0, 0.0, 1.0]
        return PathSamples(p_WB=p, v_WB_W=rest + v, a_WB_W=rest, j_WB_W=rest)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """The truth (n, 3), the nearest that an obstacle's surface came, and the ticks' figures."""

    p_WB: Array
    nearest: float
    steps: list[LoopStep]

    @property
    def states(self) -> list[str]:
        """States of the avoidance in order, without repetitions."""
        seen: list[str] = []
        for step in self.steps:
            assert step.tick is not None
            state = step.tick.stats.avoidance
            if not seen or seen[-1] != state:
                seen.append(state)
        return seen

    def last(self) -> Any:
        """Return the last tick's figures."""
        tick = self.steps[-1].tick
        assert tick is not None
        return tick.stats


def flown(
    obstacles: Standing, *, speed: float = 2.0, duration: float = 4.0, config: MpcConfig = CONFIG
) -> Flight:
    """Fly straight on, with obstacles in the way."""
    controller = Controller(config, guide=ObstacleAvoidance(config, obstacles, radius=RADIUS))
    steps = list(
        fly(
            mpc=config,
            simulator=SimulatorConfig(duration=duration),
            reference=ReferenceConfig(),
            trajectory=Straight(speed),
            controller=controller,
            on_reference=True,
        )
    )
    p_WB = np.array([step.truth.p_WB for step in steps])
    nearest = np.inf
    if len(obstacles.known):
        nearest = np.linalg.norm(p_WB[:, None] - obstacles.known, axis=2).min()
    if obstacles._ball is not None:
        balls = np.array([obstacles.ball_at(step.truth.stamp_ns) for step in steps])
        apart = np.linalg.norm(p_WB - balls, axis=1) - obstacles.radius
        nearest = min(nearest, apart.min())
    assert all(step.tick is not None and step.tick.decision.source is Source.MPC for step in steps)
    return Flight(p_WB=p_WB, nearest=float(nearest), steps=steps)


def odometry_at(p_WB: Array, v_WB_B: Array | None = None) -> OdometrySample:
    return OdometrySample(
        stamp_ns=10**9,
        p_WB=p_WB,
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=np.zeros(3) if v_WB_B is None else v_WB_B,
        w_WB_B=np.zeros(3),
    )


def test_clear_reference_returns_the_unchanged_window() -> None:
    guide = ObstacleAvoidance(CONFIG, Standing(PILLAR), radius=RADIUS)
    window = ReferenceWindow.hover([2.0, 0.0, 1.0], stamp_ns=10**9)
    guided = guide.guide(odometry_at(np.array([0.0, 0.0, 1.0])), window, None)
    assert guided.window is window
    assert guided.corridor is None
    assert guided.avoidance.state == "free"
    assert guided.avoidance.clearance == pytest.approx(3.9 - RADIUS, abs=0.01)


def test_commands_next_to_obstacles_equal_commands_without_obstacles() -> None:
    beside = box(np.array([3.0, 1.5, 1.5]), np.array([0.2, 0.2, 3.0]))
    near, alone = flown(Standing(beside)), flown(Standing())
    assert near.states == ["free"]
    for one, other in zip(near.steps, alone.steps, strict=True):
        assert one.command is not None and other.command is not None
        assert one.command.throttle == other.command.throttle
        assert one.command.w_WB_B.tobytes() == other.command.w_WB_B.tobytes()


@pytest.mark.parametrize(
    ("speed", "changes"),
    [
        (30.0, {}),
        (150.0, {}),
        (15.0, {"advanced.obstacles.margin_growth": 0.1}),
    ],
)
def test_finds_a_path_for_any_clearance(speed: float, changes: dict[str, object]) -> None:
    config = CONFIG.updated(changes)
    seconds = np.arange(0.0, 2.01, 0.05)
    line = np.array([0.0, 0.0, 1.0]) + seconds[:, None] * [5.0, 0.0, 0.0]
    window = window_through(seconds, line, stamp_ns=10**9)
    guide = ObstacleAvoidance(config, Standing(PILLAR), radius=config.radius)
    odometry = odometry_at(np.array([-1.0, 0.0, 1.0]), np.array([speed, 0.0, 0.0]))
    guided = guide.guide(odometry, window, None)
    assert guided.avoidance.state == "around"


def test_the_guide_turns_the_thrust_against_the_configured_gravity() -> None:
    config = CONFIG.updated({"gravity": 3.7})
    seconds = np.arange(0.0, 2.01, 0.05)
    line = np.array([2.5, 0.0, 1.0]) + seconds[:, None] * [2.0, 0.0, 0.0]
    window = window_through(seconds, line, stamp_ns=10**9, gravity=3.7)
    guide = ObstacleAvoidance(config, Standing(PILLAR), radius=RADIUS)
    odometry = odometry_at(np.array([2.5, 0.0, 1.0]), np.array([2.0, 0.0, 0.0]))
    flown = guide.guide(odometry, window, None).window
    assert flown is not window
    force = flown.a_WB_W + np.array([0.0, 0.0, 3.7])
    axis = so3.rotation_from_quaternion_xyzw(flown.q_WB_xyzw)[:, :, 2]
    np.testing.assert_allclose(np.cross(axis, force), 0.0, atol=1e-9)
    assert np.abs(flown.a_WB_W).max() > 0.5


def test_live_change_of_the_range_updates_the_map() -> None:
    guide = ObstacleAvoidance(CONFIG, Standing(PILLAR), radius=RADIUS)
    window = ReferenceWindow.hover([0.0, 0.0, 1.0], stamp_ns=10**9)
    odometry = odometry_at(np.array([0.0, 0.0, 1.0]))
    assert math.isfinite(guide.guide(odometry, window, None).avoidance.clearance)
    guide.reconfigure(CONFIG.updated({"obstacles.range": 2.0}))
    assert guide.guide(odometry, window, None).avoidance.clearance == math.inf


def test_goes_around_a_pillar_and_returns() -> None:
    flight = flown(Standing(PILLAR), duration=5.0)
    assert flight.nearest > RADIUS + 0.05
    assert flight.states == ["free", "around", "free"]
    assert flight.last().solver_failures == 0
    np.testing.assert_allclose(flight.p_WB[-1], [10.0, 0.0, 1.0], atol=0.3)


def test_stops_in_front_of_a_wall_with_a_reason() -> None:
    wall = box(np.array([4.0, 0.0, 2.0]), np.array([0.1, 18.0, 14.0]))
    flight = flown(Standing(wall), duration=6.0)
    assert flight.nearest > RADIUS
    assert flight.last().avoidance == "stopped"
    assert "no path leads closer to the reference" in flight.last().avoidance_reason
    rest = flight.p_WB[-25:]
    assert np.ptp(rest, axis=0).max() < 0.1, "it hovers"
    assert 3.0 < rest[-1, 0] < 3.95 - RADIUS


@pytest.mark.parametrize("across", [-1.0, 1.0])
def test_waits_for_a_crossing_ball(across: float) -> None:
    ball = np.array([4.0, -2.0 * across, 1.0]), np.array([0.0, across, 0.0])
    flight = flown(Standing(ball=ball), duration=4.0)
    assert flight.nearest > RADIUS
    assert "around" in flight.states
    straight = flown(Standing(), duration=4.0).p_WB
    balls = ball[0] + 0.02 * np.arange(len(straight))[:, None] * ball[1]
    assert np.linalg.norm(straight - balls, axis=1).min() < 0.3, "it would have been hit"


def test_hover_fallback_stops_inside_the_free_region(monkeypatch: pytest.MonkeyPatch) -> None:
    """The solver fails for good on the way to a wall: plan, then hover, and no contact."""
    wall = box(np.array([4.0, 0.0, 2.0]), np.array([0.1, 18.0, 14.0]))
    obstacles = Standing(wall)
    controller = Controller(CONFIG, guide=ObstacleAvoidance(CONFIG, obstacles, radius=RADIUS))
    original, failing = QpSolver.solve, False

    def solve(solver: QpSolver, **how: bool) -> Any:
        solution = original(solver, **how)
        return solution._replace(solved=not failing)

    monkeypatch.setattr(QpSolver, "solve", solve)
    nearest, sources = np.inf, set()
    for step in fly(
        mpc=CONFIG,
        simulator=SimulatorConfig(duration=5.0),
        trajectory=Straight(2.0),
        controller=controller,
        on_reference=True,
    ):
        failing = failing or bool(step.truth.p_WB[0] > 2.7)
        nearest = min(nearest, np.linalg.norm(wall - step.truth.p_WB, axis=1).min())
        assert step.tick is not None
        sources.add(step.tick.decision.source)
    assert sources == {Source.MPC, Source.PLAN, Source.HOVER}
    assert nearest > RADIUS
    assert np.linalg.norm(step.truth.v_WB_B) < 0.1


def test_keeps_a_path_through_a_slightly_too_narrow_gap() -> None:
    def wall(width: float) -> Array:
        halves = [
            box(np.array([3.0, side * (2.0 + 0.5 * width), 1.5]), np.array([0.1, 4.0, 4.0]))
            for side in (-1.0, 1.0)
        ]
        return np.vstack(halves)

    obstacles = Standing(wall(1.1))
    guide = ObstacleAvoidance(CONFIG, obstacles, radius=RADIUS)
    window = ReferenceWindow.hover([6.0, 0.0, 1.0], stamp_ns=10**9)
    start, speed = np.array([1.2, 0.9, 1.0]), np.array([1.0, 0.0, 0.0])
    first = guide.guide(odometry_at(start, speed), window, None)
    obstacles.known, obstacles.revision = wall(1.04), 1
    later = OdometrySample(
        stamp_ns=10**9 + 120_000_000,
        p_WB=first.window.p_WB[3],
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=first.window.v_WB_W[3],
        w_WB_B=np.zeros(3),
    )
    then = guide.guide(later, window, None)
    for guided in (first, then):
        assert guided.avoidance.state == "around"
        assert abs(guided.window.p_WB[-1, 1]) < 0.3, "to the gap"
    fresh = ObstacleAvoidance(CONFIG, obstacles, radius=RADIUS).guide(later, window, None)
    assert fresh.avoidance.state == "stopped", "a search does not find it"

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Space shared by neighbours: planes that both know, and meetings that are mirror images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from fixtures.obstacles import Standing

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.extras.obstacles.neighbours import Plans, Shared, shared_space
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

KEEP = 0.5
SCALE = np.array([1.0, 1.0, 0.5])


def half_of(own: Array, other: Array) -> Shared | None:
    plans = Plans(other[None], np.zeros(1))
    return shared_space(own, plans, keep=np.array([KEEP]), heights_count=0.5)


@pytest.mark.parametrize("seed", range(6))
def test_each_half_keeps_the_scaled_distance(seed: int) -> None:
    """By brute force: places at random in one half are that far from all in the other."""
    rng = np.random.default_rng(seed)
    own = rng.normal(scale=0.4, size=(5, 3))
    other = own + rng.normal(scale=0.5, size=(5, 3))
    mine, theirs = half_of(own, other), half_of(other, own)
    assert mine is not None and theirs is not None
    np.testing.assert_allclose(mine.normals, -theirs.normals, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(mine.normals, axis=2), 1.0)
    for i in range(5):
        places = rng.uniform(-2.0, 2.0, size=(400, 3))
        here = places[places @ mine.normals[i, 0] <= mine.offsets[i, 0]]
        there = places[places @ theirs.normals[i, 0] <= theirs.offsets[i, 0]]
        assert len(here) and len(there)
        apart = np.linalg.norm((here[:, None] - there) * SCALE, axis=2)
        assert apart.min() >= KEEP - 1e-9


def test_distant_plans_need_no_half_space() -> None:
    own = np.zeros((4, 3))
    assert half_of(own, own + np.array([2.0, 0.0, 0.0])) is None
    assert half_of(own, own + np.array([0.0, 0.0, 2.0])) is None
    assert half_of(own, own + np.array([0.0, 0.0, 1.0])) is not None, "below, heights count half"


def test_nearest_comes_first() -> None:
    own = np.zeros((3, 3))
    others = np.array([own + np.array([0.8, 0.0, 0.0]), own + np.array([0.0, 0.6, 0.0])])
    shared = shared_space(
        own, Plans(others, np.zeros(2)), keep=np.full(2, KEEP), heights_count=0.5
    )
    assert shared is not None
    assert shared.normals[0, 0, 1] > 0.9
    assert shared.normals[0, 1, 0] > 0.9


class Others(Standing):
    """Nothing that stands; the plans of others as they were a tick ago."""

    def __init__(self, plans: dict[int, Plan], number: int) -> None:
        super().__init__()
        self._plans, self._number = plans, number

    def plans(self, stamps_ns: Sequence[int]) -> Plans:
        others = [plan for number, plan in self._plans.items() if number != self._number]
        places = []
        for plan in others:
            at = 1e-9 * (np.array(stamps_ns) - plan.stamp_ns)
            known = plan.step * np.arange(len(plan.p_WB))
            places.append(np.stack([np.interp(at, known, p) for p in plan.p_WB.T], axis=1))
        return Plans(np.array(places).reshape(-1, len(stamps_ns), 3), np.full(len(others), 0.02))


def test_symmetric_encounter_does_not_block() -> None:
    """Two change places, exactly head-on: each gives way to his right, both arrive."""
    parameters = {"obstacles.half_spaces": 8, "obstacles.neighbours": ("other",)}
    config, radius = MpcConfig().updated(parameters), 0.25
    plans: dict[int, Plan] = {}
    ends = np.array([[-3.0, 0.0, 1.5], [3.0, 0.0, 1.5]])

    def flight(number: int) -> Any:
        others = Others(plans, number)
        guide = ObstacleAvoidance(config, others, radius=radius)
        controller = Controller(config, guide=guide)

        def law(odometry: OdometrySample, _: ReferenceWindow) -> Any:
            goal = ReferenceWindow.hover(ends[1 - number], stamp_ns=odometry.stamp_ns)
            tick = controller.step(odometry, goal)
            assert tick is not None and tick.plan is not None
            plans[number] = tick.plan
            return tick.command

        simulator = SimulatorConfig(
            duration=6.0, initial_position=tuple(ends[number]), initial_throttle=0.2923
        )
        return fly(mpc=config, simulator=simulator, controller=law)

    nearest, right = np.inf, []
    for one, other in zip(flight(0), flight(1), strict=True):
        apart = one.truth.p_WB - other.truth.p_WB
        nearest = min(nearest, float(np.linalg.norm(apart * SCALE)))
        right.append((one.truth.p_WB[1], other.truth.p_WB[1]))
    assert nearest >= 2.0 * radius
    assert min(y for y, _ in right) < -0.2 and max(y for _, y in right) > 0.2
    np.testing.assert_allclose(one.truth.p_WB, ends[1], atol=0.1)
    np.testing.assert_allclose(other.truth.p_WB, ends[0], atol=0.1)

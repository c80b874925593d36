# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where a reference is left and rejoined: a straight one at once, one that bends late."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.obstacles import Standing, box
from fixtures.windows import window_through

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.extras.obstacles.bypass import Bypass, Preview, find_bypass
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

TIMES = np.linspace(0.0, 2.0, 41)
CONFIG = MpcConfig().updated({"obstacles.half_spaces": 8})
RADIUS, SPEED, HEIGHT = 2.0, 2.5, 1.0


class Circle:
    """Of 2 m about the origin, 1 m high, at 2.5 m/s."""

    periodic = True
    duration = 2.0 * np.pi * RADIUS / SPEED

    def at(self, seconds: Array) -> PathSamples:
        w = SPEED / RADIUS
        angle = w * np.asarray(seconds)
        out = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        on = np.column_stack([-np.sin(angle), np.cos(angle), 0.0 * angle])
        return PathSamples(
            p_WB=RADIUS * out + [0.0, 0.0, HEIGHT],
            v_WB_W=SPEED * on,
            a_WB_W=-SPEED * w * out,
            j_WB_W=-SPEED * w * w * on,
        )


def circle_ahead() -> Preview:
    return Preview.of(window_through(TIMES, Circle().at(TIMES).p_WB), 0)


def straight_ahead() -> Preview:
    places = np.outer(TIMES, [2.0, 0.0, 0.0]) + np.array([0.0, 0.0, HEIGHT])
    return Preview.of(window_through(TIMES, places), 0)


def chosen(ahead: Preview, blocked: slice, *, astray: bool = False) -> Bypass:
    clear = np.ones(len(ahead.times), dtype=bool)
    clear[blocked] = False
    around = find_bypass(ahead, clear, np.ones_like(clear), speed_max=4.0, astray=astray)
    assert around is not None
    return around


def test_straight_reference_is_left_at_once_and_rejoined_at_its_end() -> None:
    assert chosen(straight_ahead(), slice(15, 20)) == Bypass(leave=0, rejoin=len(TIMES) - 1)


@pytest.mark.parametrize("first", [5, 12, 20, 26])
def test_curved_reference_is_left_late_and_rejoined_early(first: int) -> None:
    """On a circle a chord of 90 % of its arc spans 90 degrees, here 25 samples."""
    around = chosen(circle_ahead(), slice(first, first + 6))
    assert max(0, first + 6 - 26) <= around.leave < first
    assert first + 6 <= around.rejoin <= around.leave + 26


def test_displaced_vehicle_leaves_at_once_and_rejoins_in_time() -> None:
    ahead = circle_ahead()
    around = chosen(ahead, slice(0, 6), astray=True)
    assert around.leave == 0
    way = np.linalg.norm(ahead.p_W[around.rejoin] - ahead.p_W[0])
    assert way <= 4.0 * ahead.times[around.rejoin]


def test_reference_blocked_to_its_end_is_flown_to_the_last_clear_point() -> None:
    ahead = straight_ahead()
    assert chosen(ahead, slice(15, None)) == Bypass(leave=0, rejoin=14)
    blocked = np.zeros(len(ahead.times), dtype=bool)
    assert find_bypass(ahead, blocked, ~blocked, speed_max=4.0, astray=False) is None


def test_preview_starts_at_the_current_reference() -> None:
    window = window_through(TIMES, Circle().at(TIMES).p_WB, stamp_ns=10**9)
    ahead = Preview.of(window, 10**9 + 330_000_000)
    assert ahead.times[0] == 0.0
    np.testing.assert_allclose(ahead.p_W[0], Circle().at(np.array([0.33])).p_WB[0], atol=1e-3)
    np.testing.assert_allclose(ahead.times[1], 0.02, atol=1e-9)
    assert np.linalg.norm(ahead.p_W[-1] - ahead.p_W[ahead.known - 1]) == pytest.approx(
        2.0, abs=0.01
    )


def distances_to_circle(standing: Array) -> tuple[Array, list[str]]:
    """Return how far a flight of two rounds is from the circle, and what avoidance said."""
    obstacles = Standing(standing)
    controller = Controller(CONFIG, guide=ObstacleAvoidance(CONFIG, obstacles, radius=0.25))
    away, states = [], []
    for step in fly(
        mpc=CONFIG,
        simulator=SimulatorConfig(duration=10.0),
        reference=ReferenceConfig(),
        trajectory=Circle(),
        controller=controller,
        on_reference=True,
    ):
        p = step.truth.p_WB
        assert np.linalg.norm(standing - p, axis=1).min() > 0.25
        away.append(np.hypot(np.hypot(p[0], p[1]) - RADIUS, p[2] - HEIGHT))
        assert step.tick is not None
        states.append(step.tick.stats.avoidance)
    return np.array(away), states


def test_circle_about_a_pillar_is_free() -> None:
    """Every chord to the end of the horizon leads through what stands in its middle."""
    away, states = distances_to_circle(box(np.array([0.0, 0.0, 1.5]), np.array([1.6, 1.6, 3.0])))
    assert set(states) == {"free"}
    assert away.max() < 0.02


def test_pillar_on_a_circle_causes_only_a_local_detour() -> None:
    pillar = box(np.array([0.0, RADIUS, 1.5]), np.array([0.2, 0.2, 3.0]))
    away, states = distances_to_circle(pillar)
    assert "around" in states
    assert "stopped" not in states
    assert away.max() < 1.0, "half a pillar, radius, margins and the room that ways give"
    assert np.median(away) < 0.05, "most of the round is the reference"


def test_jump_through_an_obstacle_is_detected_in_advance() -> None:
    places = np.where(TIMES[:, None] < 0.5, [0.0, 0.0, 1.0], [4.0, 0.0, 1.0])
    window = ReferenceWindow(
        stamp_ns=0,
        offset_ns=np.rint(1e9 * TIMES).astype(np.int64),
        p_WB=places,
        q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (len(TIMES), 1)),
        v_WB_W=np.zeros_like(places),
        a_WB_W=np.zeros_like(places),
        w_WB_W=np.zeros_like(places),
    )
    pillar = Standing(box(np.array([2.0, 0.0, 1.5]), np.array([0.2, 0.2, 3.0])))
    guide = ObstacleAvoidance(CONFIG, pillar, radius=0.25)
    guided = guide.guide(OdometrySample.at_rest([0.0, 0.0, 1.0]), window, None)
    assert guided.avoidance.state == "around"

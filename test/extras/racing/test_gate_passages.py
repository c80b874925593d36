# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gate passages of paths with known passages."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.racing.gate_passages import Lap, MovedGates, passages
from quad_mpc_ros.extras.racing.gates import course_from
from quad_mpc_ros.references.course import Course

SECONDS = np.linspace(0.0, 10.0, 501)


def course(*gates: dict[str, Any], **more: Any) -> Course:
    return course_from({"start": [0.0, 0.0, 1.0], "gates": list(gates), **more})


def opening(x: float, y: float = 0.0, **more: Any) -> dict[str, Any]:
    return {"position": [x, y, 1.0], "yaw": 0.0, "width": 2.0, "height": 1.0, **more}


def ball(x: float, y: float, tolerance: float = 0.3) -> dict[str, Any]:
    return {"position": [x, y, 1.0], "tolerance": tolerance}


def straight(speed: float = 1.0, y: float = 0.0) -> Array:
    return np.column_stack((speed * SECONDS, np.full_like(SECONDS, y), np.ones_like(SECONDS)))


def flown(course: Course, p_WB: Array, radius: float = 0.0) -> Lap:
    return passages(course, seconds=SECONDS, p_WB=p_WB, radius=radius)


def test_time_and_distance_in_the_plane() -> None:
    lap = flown(course(opening(2.013), opening(5.0)), straight(y=0.4))
    assert [passage.passed for passage in lap.passages] == [True, True]
    assert_allclose([passage.time for passage in lap.passages], [2.013, 5.0])
    assert_allclose([passage.miss for passage in lap.passages], 0.4)
    assert lap.time == pytest.approx(5.0)


@given(st.integers(0, 2**32 - 1))
def test_a_position_in_the_gate_plane_is_passed_once(seed: int) -> None:
    """Whatever rounding makes of its distance from the plane."""
    random = np.random.default_rng(seed)
    yaw = random.uniform(-1.0, 1.0)
    gate = {"position": random.uniform(1, 5, 3).tolist(), "yaw": yaw, "tolerance": 1.0}
    beyond = {"position": [50.0, 0.0, 1.0], "tolerance": 1.0}
    made = course_from({"start": [-20.0, 0.0, 1.0], "gates": [gate, beyond]}, source="here")
    axes = made.gates[0].R_WG
    assert axes is not None
    across = random.uniform(-0.5, 0.5, 2) @ axes.T[1:]
    ways = np.array([-0.3, 0.0, 0.4])[:, None] * axes[:, 0]
    p_WB = made.gates[0].p_WG + across + ways
    lap = passages(made, seconds=np.arange(3.0), p_WB=p_WB)
    assert lap.passages[0].time == pytest.approx(1.0)


def test_ball_is_passed_at_the_point_of_closest_approach() -> None:
    lap = flown(course(ball(3.004, 0.2), ball(6.0, -0.4)), straight())
    assert_allclose([passage.time for passage in lap.passages], [3.004, 6.0], atol=1e-9)
    assert_allclose([passage.miss for passage in lap.passages], [0.2, 0.4])
    assert [passage.passed for passage in lap.passages] == [True, False]
    assert lap.missed == 1 and lap.time is None


@pytest.mark.parametrize(
    ("y", "passed", "clipped"),
    [(0.7, True, False), (0.9, True, True), (1.1, False, True), (1.3, False, False)],
)
def test_edges_are_clipped_from_both_sides(y: float, passed: bool, clipped: bool) -> None:
    tall = {"height": 4.0}
    lap = flown(course(opening(2.0, **tall), opening(4.0, **tall)), straight(y=y), radius=0.2)
    assert [(p.passed, p.clipped) for p in lap.passages] == [(passed, clipped)] * 2


def test_reverse_passage_counts_only_with_direction_both() -> None:
    back = straight()[::-1]
    one = flown(course(opening(6.0), opening(7.0)), back)
    assert [passage.time for passage in one.passages] == [None, None]
    both = {"direction": "both"}
    two = flown(course(opening(7.0, **both), opening(6.0, **both)), back)
    assert_allclose([passage.time for passage in two.passages], [3.0, 4.0])


def test_separates_the_laps_of_a_circle() -> None:
    angle = 2.0 * np.pi * SECONDS / 5.0 - 0.1  # two laps
    p_WB = np.column_stack((3.0 * np.cos(angle), 3.0 * np.sin(angle), np.ones_like(angle)))
    lap = flown(course(ball(3.0, 0.0), ball(-3.0, 0.0), laps=2), p_WB)
    times = 5.0 / (2.0 * np.pi) * (np.array([0.0, 1.0, 2.0, 3.0]) * np.pi + 0.1)
    assert_allclose([passage.time for passage in lap.passages], times, atol=1e-3)
    assert lap.missed == 0


def test_gates_count_in_the_order_of_the_course() -> None:
    lap = flown(course(ball(6.0, 0.0), ball(3.0, 0.0)), straight())
    assert [passage.passed for passage in lap.passages].count(True) == 1


def test_end_is_reached_within_its_tolerance_after_the_gates() -> None:
    end = {"end": {"position": [7.0, 0.0, 1.0], "tolerance": 0.5}}
    lap = flown(course(ball(3.0, 0.0), ball(6.0, 0.0), **end), straight())
    assert lap.time == pytest.approx(6.5, abs=1e-9)
    beside = flown(course(ball(3.0, 0.0), ball(6.0, 0.0), **end), straight(y=0.51))
    assert beside.time is None


@given(st.integers(0, 2**32 - 1))
def test_no_other_choice_passes_more(seed: int) -> None:
    """Against all choices of one crossing a gate, by brute force."""
    random = np.random.default_rng(seed)
    knots = random.uniform(-1.5, 1.5, (8, 2))
    grid = np.linspace(0.0, 7.0, 200)
    xy = np.column_stack([np.interp(grid, np.arange(8.0), column) for column in knots.T])
    p_WB = np.column_stack((xy, np.ones(len(grid))))
    gates = [opening(0.3, 0.9, width=1.0), opening(-0.4, -0.6, width=1.0), opening(0.9, 0.0)]
    lap = passages(course(*gates), seconds=grid, p_WB=p_WB)
    times = [passage.time for passage in lap.passages if passage.time is not None]
    assert times == sorted(times)
    choices = []
    for gate in gates:
        x, y = gate["position"][:2]
        found: list[tuple[float, bool] | None] = [None]
        for k in range(len(grid) - 1):
            if xy[k, 0] < x <= xy[k + 1, 0]:
                share = (x - xy[k, 0]) / (xy[k + 1, 0] - xy[k, 0])
                across = xy[k, 1] + share * (xy[k + 1, 1] - xy[k, 1]) - y
                when = grid[k] + share * (grid[k + 1] - grid[k])
                found.append((when, abs(across) <= 0.5 * gate["width"]))
        choices.append(found)
    best = 0
    for chosen in itertools.product(*choices):
        taken = [each for each in chosen if each is not None]
        if all(a[0] < b[0] for a, b in itertools.pairwise(taken)):
            best = max(best, sum(passed for _, passed in taken))
    assert len(lap.passages) - lap.missed == best


def test_moving_gate_is_evaluated_at_its_pose_of_the_passage() -> None:
    """The gate moves aside at 3 s; the path passes its first place at 2 s or at 5 s."""
    before = course(opening(2.0), opening(8.0))
    after = before.moved(
        np.array([[2.0, 1.5, 1.0], [8.0, 1.5, 1.0]]), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    )
    held = (SECONDS >= 3.0).astype(np.int64)
    moved = MovedGates(courses=[before, after], held=held)

    def passed(p_WB: Array) -> list[bool]:
        lap = passages(before, seconds=SECONDS, p_WB=p_WB, moved=moved)
        return [passage.passed for passage in lap.passages]

    aside = straight(y=1.5)
    assert passed(straight()) == [True, False]
    assert passed(aside) == [False, True]
    assert passed(np.where(SECONDS[:, None] < 4.0, straight(), aside)) == [True, True]
    none = MovedGates(courses=[before], held=np.zeros_like(held))
    same = passages(before, seconds=SECONDS, p_WB=straight(y=0.4), moved=none)
    assert same == flown(before, straight(y=0.4))

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Transitions and the director: nothing jumps, whatever is asked for and when."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.director import HOLD, TOO_LATE, Director, Reply
from quad_mpc_ros.references.flatness import yaw_of
from quad_mpc_ros.references.minimum_snap import End
from quad_mpc_ros.references.timeline import Timeline
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.references.transition import CHECK_HEIGHT, CHECK_RADIUS, FlatState, transition

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
GROUND = np.array([1.0, -1.0, 0.0])
LIMITS = {"max_acceleration": 5.0, "max_speed": 4.0}


def configured(trajectory: str = "circle", **changes: object) -> ReferenceConfig:
    values = {"trajectory": trajectory, "takeoff_height": 2.0, **LIMITS, **changes}
    return ReferenceConfig.build(values)


@functools.cache
def flown(trajectory: str) -> Trajectory:
    return configured_trajectory(configured(trajectory))


def directed(**changes: object) -> Director:
    return Director.on_ground(configured(**changes), p_WB=GROUND, yaw=0.5)


def airborne() -> tuple[Director, int]:
    """Return a director that holds 2 m above the ground, and the time."""
    director = directed()
    assert director.take_off(START).accepted
    now = START + 10 * SECOND
    assert director.mode(now) == "hold"
    return director, now


def assert_nothing_jumps(timeline: Timeline, start_ns: int, end_ns: int) -> None:
    """Where one phase ends and the next begins, a nanosecond apart, all is the same."""
    starts = {timeline.phase(time).start_ns for time in range(start_ns, end_ns, SECOND // 100)}
    for start in sorted(starts - {timeline.phase(start_ns).start_ns}):
        left, right = timeline.at([start - 1]), timeline.at([start])
        for name, tolerance in (("p_WB", 1e-7), ("v_WB_W", 1e-6), ("a_WB_W", 1e-5)):
            assert_allclose(getattr(left, name), getattr(right, name), atol=tolerance)
        assert_allclose(left.w_WB_W, right.w_WB_W, atol=1e-2)  # from a differentiated jerk
        R_left, R_right = (so3.rotation_from_quaternion_xyzw(s.q_WB_xyzw) for s in (left, right))
        assert_allclose(R_left, R_right, atol=1e-6)


def at(director: Director, time_ns: int) -> tuple[Array, Array, Array]:
    """Return position, velocity and rotation."""
    samples = director.timeline.at([time_ns])
    R_WB = so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw[0])
    return samples.p_WB[0], samples.v_WB_W[0], R_WB


@pytest.mark.parametrize("checks", [True, False])
def test_a_take_off_circles_near_the_ground_if_it_checks_the_axes(checks: bool) -> None:
    director = directed(takeoff_check=checks)
    assert director.take_off(START).accepted
    assert_nothing_jumps(director.timeline, START, START + 10 * SECOND)

    times = [START + k * SECOND // 100 for k in range(1000)]
    found = director.timeline.at(times)
    aside = found.p_WB[:, :2] - GROUND[:2]
    widest = np.ptp(aside, axis=0)
    assert_allclose(widest, 2.0 * CHECK_RADIUS if checks else 0.0, atol=1e-4)
    moves = np.hypot(*aside.T) > 1e-9
    assert_allclose(found.p_WB[moves, 2], GROUND[2] + CHECK_HEIGHT, atol=1e-12)
    velocity = np.gradient(found.p_WB, 0.01, axis=0)
    assert_allclose(velocity, found.v_WB_W, atol=5e-3)
    assert_allclose(np.gradient(found.v_WB_W, 0.01, axis=0), found.a_WB_W, atol=0.05)
    assert np.abs(found.a_WB_W[:, :2]).max() < 1.5


@pytest.mark.parametrize("height", [0.1, 0.14, 0.26, 0.3, 0.38, 0.5, 2.0])
def test_a_take_off_of_an_agile_vehicle_stays_upright(height: float) -> None:
    director = directed(max_acceleration=20.0, takeoff_height=height)
    assert director.take_off(START).accepted
    times = [START + k * SECOND // 100 for k in range(600)]
    assert np.abs(director.timeline.at(times).a_WB_W).max() < 0.6 * 9.81


def test_a_take_off_to_less_than_the_height_of_the_circle_only_climbs() -> None:
    director = directed(takeoff_height=0.2)
    assert director.take_off(START).accepted
    end = director.timeline.at([START + 10 * SECOND]).p_WB[0]
    assert_allclose(end, GROUND + np.array([0.0, 0.0, 0.2]), atol=1e-12)
    assert_nothing_jumps(director.timeline, START, START + 10 * SECOND)


def test_flies_all_phases_of_a_flight() -> None:
    director = directed(takeoff_height=1.5)
    assert director.mode(START) == "ground"
    assert_allclose(at(director, START)[0], GROUND)
    assert director.take_off(START).accepted
    assert director.mode(START + SECOND // 10) == "takeoff"
    now = START + 6 * SECOND
    assert director.mode(now) == "hold"
    assert_allclose(at(director, now)[0], [1.0, -1.0, 1.5], atol=1e-9)
    assert director.fly(now, flown("circle")).accepted
    assert director.mode(now) == "going"
    now += 9 * SECOND
    assert director.mode(now) == "tracking"
    p_WB, v_WB_W, _ = at(director, now)
    assert np.linalg.norm(p_WB - [0.0, 0.0, 2.0]) == pytest.approx(2.0)
    assert np.linalg.norm(v_WB_W) == pytest.approx(2.0)
    assert director.hold(now).accepted
    now += 5 * SECOND
    assert director.mode(now) == "hold"
    assert director.go_to(now, p_WB=np.array([4.0, 4.0, 3.0]), yaw=-2.0).accepted
    now += 9 * SECOND
    p_WB, v_WB_W, R_WB = at(director, now)
    assert_allclose(p_WB, [4.0, 4.0, 3.0], atol=1e-9)
    assert yaw_of(R_WB) == pytest.approx(-2.0)
    assert director.land(now).accepted
    assert director.mode(now + SECOND // 10) == "landing"
    now += 9 * SECOND
    assert director.is_sinking(now)
    assert_allclose(at(director, now)[1], [0.0, 0.0, -0.3])
    assert_allclose(at(director, now)[0][:2], [4.0, 4.0], atol=1e-6)
    ground = np.array([4.01, 3.98, 0.1])
    assert_nothing_jumps(director.timeline, START - SECOND, now)
    touched = now
    assert director.touched(now, p_WB=ground).accepted
    assert not director.is_sinking(now)
    now += 9 * SECOND
    assert director.mode(now) == "ground"
    assert_allclose(at(director, now)[0], ground, atol=1e-6)
    assert director.take_off(now).accepted
    assert_allclose(at(director, now + 9 * SECOND)[0], [4.01, 3.98, 1.6], atol=1e-6)
    assert_nothing_jumps(director.timeline, touched, now + SECOND)
    assert director.timeline.jumps(START - SECOND, now + SECOND) == []


REQUESTS: dict[str, Callable[[Director, int], Reply]] = {
    "start": lambda director, now: director.fly(now, flown("circle")),
    "hold": lambda director, now: director.hold(now),
    "land": lambda director, now: director.land(now),
    "goal": lambda director, now: director.go_to(now, p_WB=np.array([2.0, 3.0, 1.5]), yaw=3.0),
}


@settings(deadline=None, max_examples=25)
@given(
    st.sampled_from(["circle", "lemniscate", "minimum_snap"]),
    st.lists(
        st.tuples(st.sampled_from(sorted(REQUESTS)), st.integers(SECOND // 20, 6 * SECOND)),
        min_size=1,
        max_size=4,
    ),
)
def test_no_request_causes_a_jump(trajectory: str, requests: list[tuple[str, int]]) -> None:
    director, now = airborne()
    assert director.fly(now, flown(trajectory)).accepted
    begun = now
    for request, wait in requests:
        now += wait
        answer = REQUESTS[request](director, now)
        assert answer.text
    assert_nothing_jumps(director.timeline, begun - SECOND // 10, now + 3 * SECOND)


def test_refuses_impossible_request_without_effect() -> None:
    director = directed()
    for request in REQUESTS.values():
        answer = request(director, START)
        assert not answer.accepted
        assert "is rejected in mode ground" in answer.text
    assert director.mode(START + 100 * SECOND) == "ground"
    director, now = airborne()
    assert "is rejected in mode hold" in director.take_off(now).text
    answer = director.go_to(now, p_WB=np.array([0.0, 0.0, -3.0]), yaw=0.0)
    assert not answer.accepted
    assert director.mode(now + SECOND) == "hold"
    assert "lowest height" in answer.text


def test_inverted_reference_continues_until_a_stop_is_possible() -> None:
    director, now = airborne()
    assert director.fly(now, flown("vertical_loop")).accepted
    while director.mode(now) != "tracking":
        now += SECOND // 100
    top = now + round(1.3 * SECOND)
    assert at(director, top)[2][2, 2] < -0.9
    for request in ("goal", "start"):
        answer = REQUESTS[request](director, top)
        assert not answer.accepted
        assert "upside down" in answer.text
    assert director.hold(top).accepted
    assert director.mode(top) == "tracking"
    assert at(director, top)[2][2, 2] < -0.9
    later = top + 10 * SECOND
    assert director.mode(later) == "hold"
    assert_allclose(at(director, later)[1], 0.0)
    assert_nothing_jumps(director.timeline, now - SECOND, later)


@pytest.mark.parametrize("request_", ["hold", "land"])
@pytest.mark.parametrize("moment", np.linspace(0.0, 4.0, 9))
def test_hold_and_land_are_never_rejected_in_flight(request_: str, moment: float) -> None:
    """Though the trajectory itself already needs more than the limits leave."""
    changes = {"trajectory": "lemniscate", "angular_frequency": 2.2}
    trajectory = configured_trajectory(ReferenceConfig.build(changes))
    config = ReferenceConfig.build({**changes, "max_acceleration": 20.0})
    director = Director.flying(config, trajectory, start_ns=START)
    director._config = dataclasses.replace(config, omega_max=(0.4, 0.4, 0.4))
    now = START + round(moment * SECOND)
    assert not director.go_to(now, p_WB=np.array([3.0, 0.0, 2.0]), yaw=0.0).accepted
    assert REQUESTS[request_](director, now).accepted
    assert_nothing_jumps(director.timeline, now - SECOND, now + 10 * SECOND)
    speed = float(np.linalg.norm(at(director, now + 10 * SECOND)[1]))
    assert speed == pytest.approx(0.3 if request_ == "land" else 0.0, abs=1e-6)


def test_drops_late_plan() -> None:
    director, now = airborne()
    director.too_late = lambda start_ns: start_ns < now + SECOND
    for request in REQUESTS.values():
        assert request(director, now) == TOO_LATE
        assert director.mode(now + SECOND // 2) == "hold"
    assert director.hold(now + SECOND).accepted


vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


@settings(deadline=None, max_examples=40)
@given(vectors, vectors, vectors, vectors, st.floats(-4.0, 4.0), st.floats(-4.0, 4.0))
def test_a_transition_joins_two_motions(
    p: Array, v: Array, a: Array, goal: Array, yaw: float, goal_yaw: float
) -> None:
    start = FlatState(end=End(p_WB=p, v_WB_W=v, a_WB_W=a, j_WB_W=-a), yaw=yaw, yaw_rate=0.3)
    path = transition(
        start,
        FlatState.at_rest(goal, yaw=goal_yaw),
        max_speed=5.0,
        max_acceleration=6.0,
        max_yaw_rate=3.0,
    )
    samples = path.at(np.linspace(0.0, path.duration, 501))
    first, last = 0, -1
    assert_allclose(samples.p_WB[first], p, atol=1e-8)
    assert_allclose(samples.v_WB_W[first], v, atol=1e-8)
    assert_allclose(samples.a_WB_W[first], a, atol=1e-7)
    assert_allclose(samples.p_WB[last], goal, atol=1e-8)
    assert_allclose(samples.v_WB_W[last], 0.0, atol=1e-8)
    assert_allclose(samples.a_WB_W[last], 0.0, atol=1e-7)
    yaws = np.asarray(samples.yaw)
    assert yaws[first] == pytest.approx(yaw)
    assert math.remainder(yaws[last] - goal_yaw, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert abs(yaws[last] - yaw) < math.pi + 1e-9  # the shorter way


@pytest.mark.parametrize("speed", [1e4, 1e19, 1e200])
def test_stops_from_implausibly_fast_odometry(speed: float) -> None:
    """No attitude stops from so fast; the reference has to go on all the same."""
    rest = FlatState.at_rest(np.array([1.0, 2.0, 3.0]), yaw=0.3)
    moving = dataclasses.replace(rest.end, v_WB_W=np.array([speed, -0.3 * speed, 0.5 * speed]))
    start = dataclasses.replace(rest, end=moving)
    director = Director.stopping(ReferenceConfig(), start, start_ns=10**18, ground=0.0)
    assert director.mode(2 * 10**18) == HOLD

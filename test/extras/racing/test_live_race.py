"""A race whose gates move: what is flown another way, from where, and that nothing jumps."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.extras.racing.gate_passages import passages
from quad_mpc_ros.extras.racing.gates import read_course
from quad_mpc_ros.extras.racing.live_race import GateTrajectory, LiveRace, smooth_part
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.course import Course
from quad_mpc_ros.references.director import TOO_LATE, Director
from quad_mpc_ros.references.trajectory import Trajectory

SECOND = 1_000_000_000
GATES = [
    {"position": [4.0, 0.0, 1.5], "yaw": 0.0, "width": 1.0, "height": 1.0},
    {"position": [8.0, 1.0, 1.5], "yaw": 0.0, "width": 1.0, "height": 1.0},
    {"position": [12.0, 0.0, 1.5], "tolerance": 0.4},
]
CONFIG = ReferenceConfig(
    trajectory="gates",
    gates=str({"start": [0.0, 0.0, 1.5], "gates": GATES, "end": [15.0, 0.0, 1.5]}),
    max_speed=4.0,
    max_acceleration=4.0,
)


@functools.cache
def raced() -> tuple[Course, Trajectory]:
    return read_course(CONFIG.gates), configured_trajectory(CONFIG)


def poses(**moved: tuple[float, float, float]) -> tuple[Array, Array]:
    """Return where the gates are, those named moved by so much [m]."""
    course, _ = raced()
    shifts = [moved.get(f"gate{number}", (0.0, 0.0, 0.0)) for number in (1, 2, 3)]
    return course.places()[1:4] + np.array(shifts), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))


def led(begin: float, **moved: tuple[float, float, float]) -> tuple[LiveRace, Any]:
    course, trajectory = raced()
    race = LiveRace(course, trajectory, planner=True)
    race.move(*poses(**moved))
    return race, race.replan_request(trajectory, begin)


def missed(course: Course, trajectory: Trajectory) -> int:
    times = list(range(0, trajectory.period_ns, 5_000_000))
    p_WB = trajectory.at(times).p_WB
    return passages(course, seconds=1e-9 * np.array(times), p_WB=p_WB).missed


def test_a_way_leaves_the_present_one_without_a_jump_and_passes_where_the_gates_are() -> None:
    course, trajectory = raced()
    there = course.moved(*poses(gate2=(0.0, 1.5, 0.3)))
    _, detour = led(0.5, gate2=(0.0, 1.5, 0.3))
    way = detour.with_part(smooth_part(detour, CONFIG), CONFIG)
    assert missed(there, trajectory) == 1
    assert missed(there, way.trajectory) == 0
    leave_ns = round(1e9 * detour.leave_seconds)
    times = leave_ns + np.arange(-100_000_000, 100_000_000, 1_000_000)
    new = way.trajectory.at(times.tolist())
    old = trajectory.at(times[: len(times) // 2].tolist())
    for name, tolerance in (("p_WB", 1e-6), ("v_WB_W", 1e-5), ("a_WB_W", 2e-3)):
        assert_allclose(getattr(new, name)[: len(times) // 2], getattr(old, name), atol=tolerance)
    # Through the tick of the join each changes by no more than by its own derivative.
    assert_allclose(np.diff(new.p_WB, axis=0), 1e-3 * new.v_WB_W[1:], atol=1e-5)
    assert_allclose(np.diff(new.v_WB_W, axis=0), 1e-3 * new.a_WB_W[1:], atol=1e-4)
    jerk = np.linalg.norm(np.diff(new.a_WB_W, axis=0), axis=1)
    assert jerk.max() < 2.0 * np.median(jerk)
    R_WB = so3.rotation_from_quaternion_xyzw(new.q_WB_xyzw)
    turned = so3.log(R_WB[1:] @ np.swapaxes(R_WB[:-1], -1, -2))
    assert_allclose(turned, 1e-3 * new.w_WB_W[1:], atol=1e-4)


@pytest.mark.parametrize(
    ("begin", "moved"),
    [
        (0.5, {}),
        (0.5, {"gate2": (0.0, 0.03, 0.0)}),  # less is no news
        (4.0, {"gate1": (0.0, 1.5, 0.0)}),  # it is behind
    ],
)
def test_keeps_the_path_while_no_gate_moves(begin: float, moved: Any) -> None:
    assert led(begin, **moved)[1] is None


def test_another_trajectory_is_left_alone() -> None:
    race, _ = led(0.5, gate2=(0.0, 1.5, 0.0))
    assert race.replan_request(configured_trajectory(CONFIG), 0.5) is None


def test_reports_the_new_path_once() -> None:
    race, detour = led(0.5, gate2=(0.0, 1.5, 0.0))
    way = detour.with_part(smooth_part(detour, CONFIG), CONFIG)
    assert race.take(detour, way).startswith("replanned: gate 2 moved 1.50 m, joins at 0.5")
    assert race.replan_request(way.trajectory, 0.6) is None
    race.move(*poses(gate2=(0.0, 1.5, 0.0), gate3=(0.0, -1.0, 0.0)))
    later = race.replan_request(way.trajectory, 1.5)
    assert later is not None and list(later.moved) == [3]
    again = later.with_part(smooth_part(later, CONFIG), CONFIG)
    there = raced()[0].moved(*poses(gate2=(0.0, 1.5, 0.0), gate3=(0.0, -1.0, 0.0)))
    assert missed(there, again.trajectory) == 0


def test_what_the_vehicle_cannot_fly_is_refused() -> None:
    _, detour = led(0.5, gate2=(0.0, 1.5, 0.0))
    part = smooth_part(detour, CONFIG)
    with pytest.raises(UserError, match="beyond the limit"):
        detour.with_part(part, dataclasses.replace(CONFIG, limit_margin=0.99))


def test_a_trajectory_that_misses_a_gate_is_no_way() -> None:
    course, trajectory = raced()
    with pytest.raises(UserError, match="does not pass gate 2"):
        GateTrajectory.of(trajectory, course.moved(*poses(gate2=(0.0, 1.5, 0.0))))


def test_a_way_is_taken_only_for_what_is_flown_and_in_time() -> None:
    _, trajectory = raced()
    director = Director.flying(CONFIG, trajectory, start_ns=SECOND)
    phase, other = director.timeline.last, configured_trajectory(CONFIG)
    director.too_late = lambda start_ns: start_ns < 2 * SECOND
    assert director.replace_trajectory(phase, other, from_ns=SECOND) is TOO_LATE
    assert director.replace_trajectory(phase, other, from_ns=3 * SECOND).accepted
    assert director.timeline.last.trajectory is other
    assert not director.replace_trajectory(phase, trajectory, from_ns=3 * SECOND).accepted

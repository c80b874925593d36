# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Minimum snap: optimality, limits, and refused waypoints."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.minimum_snap import (
    End,
    Leg,
    leg_within,
    minimum_snap_path,
    snap_spline,
)

POINTS = np.array([[0.0, 0.0, 1.0], [2.0, 0.5, 1.5], [2.5, 2.0, 3.0], [0.0, 2.0, 2.0]])
TIMES = np.array([0.0, 1.2, 2.0, 3.7])

points = st.lists(
    st.tuples(*[st.floats(-5.0, 5.0)] * 2, st.floats(0.5, 5.0)), min_size=2, max_size=7
).filter(lambda found: all(math.dist(a, b) > 0.2 for a, b in itertools.pairwise(found)))


def solved_by_kkt(values: Array, times: Array) -> list[Array]:
    """Return polynomials (8 coefficients a leg, from the leg's start) by the dense KKT system.

    The textbook's quadratic program: the integral of the squared snap, subject to the values at
    both ends of each leg, to rest at the ends and to continuity up to the third derivative only.
    """
    legs, size = len(values) - 1, 8
    H, rows, right = np.zeros((legs * size, legs * size)), [], []

    def row(leg: int, time: float, order: int) -> Array:
        found = np.zeros(legs * size)
        for power in range(order, size):
            found[leg * size + power] = math.perm(power, order) * time ** (power - order)
        return found

    for leg, width in enumerate(np.diff(times)):
        for i in range(4, size):
            for j in range(4, size):
                H[leg * size + i, leg * size + j] = (
                    math.perm(i, 4) * math.perm(j, 4) * width ** (i + j - 7) / (i + j - 7)
                )
        rows += [row(leg, 0.0, 0), row(leg, width, 0)]
        right += [values[leg], values[leg + 1]]
        for order in (1, 2, 3):
            if leg == 0:
                rows.append(row(0, 0.0, order))
                right.append(0.0)
            if leg + 1 < legs:
                rows.append(row(leg, width, order) - row(leg + 1, 0.0, order))
            else:
                rows.append(row(leg, width, order))
            right.append(0.0)
    A = np.array(rows)
    zeros = np.zeros((len(A), len(A)))
    K = np.block([[H, A.T], [A, zeros]])
    solution = np.linalg.lstsq(K, np.concatenate((np.zeros(len(H)), right)), rcond=None)[0]
    return list(solution[: legs * size].reshape(legs, size))


def test_equals_the_solution_of_a_dense_quadratic_program() -> None:
    spline = snap_spline(POINTS, TIMES)
    for axis in range(3):
        for leg, coefficients in enumerate(solved_by_kkt(POINTS[:, axis], TIMES)):
            inside = np.linspace(0.0, TIMES[leg + 1] - TIMES[leg], 30)
            expected = np.polynomial.polynomial.polyval(inside, coefficients)
            assert_allclose(spline(TIMES[leg] + inside)[:, axis], expected, atol=1e-6)


@settings(deadline=None, max_examples=25)
@given(points, st.floats(0.5, 8.0), st.floats(0.5, 8.0))
def test_passes_every_waypoint_with_one_active_limit(
    found: list[tuple[float, ...]], max_speed: float, max_acceleration: float
) -> None:
    wanted = np.array(found)
    path = minimum_snap_path(wanted, max_speed=max_speed, max_acceleration=max_acceleration)
    samples = path.at(np.linspace(0.0, path.duration, 8001))
    speed = np.linalg.norm(samples.v_WB_W, axis=1).max()
    acceleration = np.linalg.norm(samples.a_WB_W, axis=1).max()
    assert speed <= 1.001 * max_speed
    assert acceleration <= 1.002 * max_acceleration
    assert speed > 0.995 * max_speed or acceleration > 0.995 * max_acceleration
    for point in wanted:
        assert np.linalg.norm(samples.p_WB - point, axis=1).min() < 2e-3 * path.duration
    assert_allclose(samples.p_WB[[0, -1]], wanted[[0, -1]], atol=1e-6)


def test_optimised_times_beat_separate_legs() -> None:
    corners = np.array([[0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2], [0, 0, 2]], dtype=float)
    path = minimum_snap_path(corners, max_speed=5.0, max_acceleration=2.0)
    one_by_one = [
        minimum_snap_path(corners[leg : leg + 2], max_speed=5.0, max_acceleration=2.0).duration
        for leg in range(4)
    ]
    assert path.duration < 0.8 * sum(one_by_one)


def test_a_leg_between_two_points_is_the_polynomial_of_degree_7() -> None:
    start, end = np.array([1.0, 2.0, 3.0]), np.array([-1.0, 0.0, 4.0])
    leg = Leg(End.at_rest(start), End.at_rest(end), duration=2.0)
    s = np.linspace(0.0, 1.0, 50)[:, None]
    share = s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
    assert_allclose(leg.at(2.0 * s[:, 0]).p_WB, start + share * (end - start), atol=1e-12)


def test_free_end_minimises_the_snap() -> None:
    end = End(
        p_WB=None,
        v_WB_W=np.array([1.0, 2.0, -1.0]),
        a_WB_W=np.array([0.0, 3.0, 1.0]),
        j_WB_W=np.array([-2.0, 0.0, 1.0]),
    )
    start = End.at_rest(np.zeros(3))
    free = Leg(start, end, duration=1.5)
    reached = free.at(np.array([1.5])).p_WB[0]
    times = np.linspace(0.0, 1.5, 4001)

    def cost(leg: Leg) -> float:
        jerk = leg.at(times).j_WB_W
        return float(np.sum((np.diff(jerk, axis=0) / np.diff(times)[:, None]) ** 2))

    for offset in np.vstack((np.eye(3), -np.eye(3))):
        moved = End(
            p_WB=reached + 0.05 * offset,
            v_WB_W=end.v_WB_W,
            a_WB_W=end.a_WB_W,
            j_WB_W=end.j_WB_W,
        )
        assert cost(Leg(start, moved, duration=1.5)) > cost(free)


def test_fastest_leg_reaches_a_limit() -> None:
    start, end = End.at_rest(np.zeros(3)), End.at_rest(np.array([3.0, 0.0, 0.0]))
    leg = leg_within(start, end, max_speed=9.0, max_acceleration=4.0)
    acceleration = np.abs(leg.at(np.linspace(0.0, leg.duration, 500)).a_WB_W).max()
    assert 0.88 * 4.0 < acceleration <= 4.0


REFUSED = {
    "none": ((), "at least 2 points, not 0"),
    "one": ((0.0, 0.0, 1.0), "at least 2 points, not 1"),
    "a number missing": ((0.0, 0.0, 1.0, 2.0, 0.0), "not 5 numbers"),
    "the same twice": ((0.0, 0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 0.0, 1.0), "waypoint 2 "),
    "not a number": ((0.0, 0.0, 1.0, math.nan, 0.0, 1.0), "list of numbers"),
}


@pytest.mark.parametrize("trajectory", ["minimum_snap", "waypoints"])
@pytest.mark.parametrize("mistake", REFUSED)
def test_refuses_invalid_waypoints(trajectory: str, mistake: str) -> None:
    given_, reason = REFUSED[mistake]
    with pytest.raises(ConfigurationError, match=r"^reference\.waypoints: given \[") as error:
        configured_trajectory(
            ReferenceConfig.build({"trajectory": trajectory, "waypoints": given_})
        )
    assert reason in str(error.value)
    assert "\n" not in str(error.value)


def test_waypoints_with_smooth_legs_rest_at_each() -> None:
    config = ReferenceConfig(trajectory="waypoints", dwell_time=0.5)
    trajectory = configured_trajectory(config)
    times = np.arange(0, trajectory.period_ns, 10_000_000)
    samples = trajectory.at(times.tolist())
    resting = np.all(np.abs(samples.v_WB_W) < 1e-12, axis=1)
    for point in np.reshape(config.waypoints, (-1, 3)):
        here = np.linalg.norm(samples.p_WB - point, axis=1) < 1e-9
        assert np.count_nonzero(here & resting) >= 49

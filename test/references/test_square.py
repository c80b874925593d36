"""The paper's square as a function of time."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.square import square
from quad_mpc_ros.references.waypoints import Steps

SECOND = 1_000_000_000
CORNERS = [[0.0, 0.0, 2.0], [2.0, 0.0, 2.0], [2.0, 2.0, 2.0], [0.0, 2.0, 2.0]]


@pytest.fixture(scope="module")
def corners() -> Steps:
    return square(ReferenceConfig())


def test_corners_come_in_order_each_for_two_seconds(corners: Steps) -> None:
    for leg, corner in enumerate([*CORNERS, *CORNERS]):
        for time in (2 * leg * SECOND, (2 * leg + 1) * SECOND, (2 * leg + 2) * SECOND - 1):
            assert_array_equal(corners.at([time]).p_WB, [corner])


def test_side_height_and_dwell_time_are_parameters() -> None:
    corners = square(ReferenceConfig(side=3.0, height=1.0, dwell_time=0.5))
    times = [0, SECOND // 2, SECOND, 3 * SECOND // 2, 2 * SECOND]
    assert_array_equal(
        corners.at(times).p_WB, [[0, 0, 1], [3, 0, 1], [3, 3, 1], [0, 3, 1], [0, 0, 1]]
    )
    assert corners.period_ns == 2 * SECOND


def test_it_begins_at_its_origin() -> None:
    corners = square(ReferenceConfig(origin=(-1.0, 4.0)))
    assert_array_equal(
        corners.at([0, 2 * SECOND, 4 * SECOND]).p_WB, [[-1, 4, 2], [1, 4, 2], [1, 6, 2]]
    )


def test_it_rests_level_and_heads_east_throughout(corners: Steps) -> None:
    samples = corners.at(list(range(0, 8 * SECOND, SECOND // 4)))
    assert_array_equal(samples.q_WB_xyzw, np.tile([0.0, 0.0, 0.0, 1.0], (32, 1)))
    for name in ("v_WB_W", "a_WB_W", "w_WB_W"):
        assert_array_equal(getattr(samples, name), np.zeros((32, 3)))


@settings(deadline=None)
@given(st.integers(-(10**19), -1))
def test_before_its_start_the_first_corner_holds(time: int) -> None:
    assert_array_equal(square(ReferenceConfig()).at([time]).p_WB, [CORNERS[0]])


@settings(deadline=None)
@given(st.integers(0, 10**18), st.integers(0, 10 * SECOND))
def test_jumps_are_where_the_position_changes(start: int, length: int) -> None:
    corners = square(ReferenceConfig(dwell_time=0.7))
    end = start + length
    jumps = corners.jumps(start, end)
    assert jumps == sorted(set(jumps))
    for jump in jumps:
        assert start < jump <= end
        assert np.any(corners.at([jump - 1]).p_WB != corners.at([jump]).p_WB)
    for left, right in itertools.pairwise([start, *jumps, end + 1]):
        assert_array_equal(corners.at([left]).p_WB, corners.at([right - 1]).p_WB)


def test_a_jump_at_the_start_is_past_and_one_at_the_end_is_not(corners: Steps) -> None:
    assert corners.jumps(0, 2 * SECOND - 1) == []
    assert corners.jumps(0, 2 * SECOND) == [2 * SECOND]
    assert corners.jumps(2 * SECOND, 4 * SECOND) == [4 * SECOND]
    assert corners.jumps(-5 * SECOND, SECOND) == []

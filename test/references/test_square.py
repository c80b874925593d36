# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's square as a function of time, and a single point, a hover."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.references.square import square

SECOND = 1_000_000_000


def test_side_height_dwell_time_and_origin_are_parameters() -> None:
    config = ReferenceConfig(side=3.0, height=1.0, dwell_time=0.5, origin=(-1.0, 4.0))
    corners = square(config)
    times = [-(10**19), 0, SECOND // 2, SECOND, 3 * SECOND // 2, 2 * SECOND]
    expected = [[-1, 4, 1], [-1, 4, 1], [2, 4, 1], [2, 7, 1], [-1, 7, 1], [-1, 4, 1]]
    samples = corners.at(times)
    assert_array_equal(samples.p_WB, expected)
    assert_array_equal(samples.q_WB_xyzw, np.tile([0.0, 0.0, 0.0, 1.0], (6, 1)))
    for name in ("v_WB_W", "a_WB_W", "w_WB_W"):
        assert_array_equal(getattr(samples, name), np.zeros((6, 3)))
    assert corners.period_ns == 2 * SECOND


DWELLS = st.integers(0, 20).map(lambda count: count * 7 * SECOND // 10)


@settings(deadline=None)
@given(
    DWELLS | DWELLS.map(lambda time: -time) | st.integers(-5 * SECOND, 10**18),
    DWELLS | st.integers(0, 10 * SECOND),
)
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


def test_hover_holds_its_point() -> None:
    config = ReferenceConfig(trajectory="hover", origin=(1.0, -2.0), height=0.7, yaw=np.pi)
    hover = configured_trajectory(config)
    samples = hover.at([-SECOND, 0, 1000 * SECOND])
    assert_array_equal(samples.p_WB, np.tile([1.0, -2.0, 0.7], (3, 1)))
    assert samples.q_WB_xyzw[0] == pytest.approx([0.0, 0.0, 1.0, 0.0])
    assert hover.smooth and hover.jumps(-SECOND, 1000 * SECOND) == []
    assert len(ReferenceServer(config, hover).whole().p_WB) == 1

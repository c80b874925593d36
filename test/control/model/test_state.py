# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The axioms of ⊞ and ⊟ on states, and the frames that they work in."""

from __future__ import annotations

import math

import numpy as np
from fixtures.box_plus import boxplus
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import (
    State,
    boxminus,
    odometry_from_state,
    state_from_odometry,
)

thorough = settings(deadline=None)


def a_state(seed: int) -> State:
    rng = np.random.default_rng(seed)
    return State(
        p_WB=rng.normal(scale=5.0, size=3),
        v_WB_B=rng.normal(scale=5.0, size=3),
        R_WB=Rotation.from_quat(rng.normal(size=4)).as_matrix(),
    )


states = st.integers(0, 2**32 - 1).map(a_state)


@st.composite
def tangents(draw: st.DrawFn) -> Array:
    """Return a tangent whose attitude part is at most just short of a half turn."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    axis = rng.normal(size=3)
    angle = draw(st.one_of(st.floats(0.0, math.pi - 1e-9), st.floats(0.0, 1e-7)))
    return np.concatenate((rng.normal(scale=5.0, size=6), angle * axis / np.linalg.norm(axis)))


def assert_same(x: State, y: State) -> None:
    assert_allclose(x.p_WB, y.p_WB, rtol=0.0, atol=1e-13)
    assert_allclose(x.v_WB_B, y.v_WB_B, rtol=0.0, atol=1e-13)
    assert_allclose(x.R_WB, y.R_WB, rtol=0.0, atol=1e-13)


@thorough
@given(states, states)
def test_boxplus_inverts_boxminus(x: State, y: State) -> None:
    assert_same(boxplus(y, boxminus(x, y)), x)


@thorough
@given(states, tangents())
def test_boxminus_inverts_boxplus(x: State, d: Array) -> None:
    assert_allclose(boxminus(boxplus(x, d), x), d, rtol=0.0, atol=1e-13)


def test_attitude_turns_in_the_body_frame() -> None:
    north = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    x = State(p_WB=np.zeros(3), v_WB_B=np.zeros(3), R_WB=north)
    rolled = boxplus(x, np.array([0, 0, 0, 0, 0, 0, 0.1, 0, 0], dtype=np.float64))
    # The body's x axis points north, along world y.
    assert_allclose(
        rolled.R_WB, Rotation.from_rotvec([0.0, 0.1, 0.0]).as_matrix() @ north, atol=1e-15
    )


@thorough
@given(states)
def test_odometry_and_state_convert_both_ways(x: State) -> None:
    w_WB_B = np.array([0.1, -0.2, 0.3])
    odometry = odometry_from_state(
        x, w_WB_B=w_WB_B, stamp_ns=123, frame_id="odom", child_frame_id="base_link"
    )
    assert (odometry.stamp_ns, odometry.frame_id, odometry.child_frame_id) == (
        123,
        "odom",
        "base_link",
    )
    assert_array_equal(odometry.w_WB_B, w_WB_B)
    assert_allclose(Rotation.from_quat(odometry.q_WB_xyzw).as_matrix(), x.R_WB, atol=1e-14)
    assert_same(state_from_odometry(odometry), x)

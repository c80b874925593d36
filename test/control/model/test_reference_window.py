# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Sampling a reference window between its samples."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.reference_window import ReferencePoints, sample
from quad_mpc_ros.control.model.samples import ReferenceWindow

STAMP = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
FIELDS = tuple(field.name for field in dataclasses.fields(ReferencePoints))


def a_window(offsets_ns: list[int], seed: int = 0) -> ReferenceWindow:
    """Return a window of random numbers."""
    rng = np.random.default_rng(seed)
    count = len(offsets_ns)
    q = rng.normal(size=(count, 4))
    return ReferenceWindow(
        stamp_ns=STAMP,
        offset_ns=np.array(offsets_ns, dtype=np.int64),
        p_WB=rng.normal(size=(count, 3)),
        q_WB_xyzw=q / np.linalg.norm(q, axis=-1, keepdims=True),
        v_WB_W=rng.normal(size=(count, 3)),
        a_WB_W=rng.normal(size=(count, 3)),
        w_WB_W=rng.normal(size=(count, 3)),
    )


def assert_same(found: ReferencePoints, expected: ReferencePoints, *, atol: float) -> None:
    for name in FIELDS:
        assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=0.0, atol=atol, err_msg=name
        )


def test_exact_at_the_samples() -> None:
    window = a_window([0, 50_000_000, 70_000_000, SECOND])
    for i, offset in enumerate(window.offset_ns[:-1].tolist()):
        found = sample(window, STAMP + offset)
        R_WB = Rotation.from_quat(window.q_WB_xyzw[i]).as_matrix()
        assert_array_equal(found.p_WB, window.p_WB[i])
        assert_array_equal(found.v_WB_W, window.v_WB_W[i])
        assert_array_equal(found.a_WB_W, window.a_WB_W[i])
        assert_allclose(found.R_WB, R_WB, atol=1e-15)
        assert_allclose(found.w_WB_B, R_WB.T @ window.w_WB_W[i], atol=1e-14)
        assert_allclose(found.v_WB_B, R_WB.T @ window.v_WB_W[i], atol=1e-14)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.integers(0, SECOND - 1))
def test_polynomials_up_to_the_third_degree_come_out_exactly(
    seed: int, degree: int, offset_ns: int
) -> None:
    rng = np.random.default_rng(seed)
    curves = [np.polynomial.Polynomial(rng.normal(size=degree + 1)) for _ in range(3)]

    def values(order: int, seconds: Array) -> Array:
        return np.stack([curve.deriv(order)(seconds) for curve in curves], axis=-1)

    offsets = np.array([0, 130_000_000, 200_000_000, 610_000_000, SECOND], dtype=np.int64)
    seconds = offsets * 1e-9
    window = dataclasses.replace(
        a_window(offsets.tolist()),
        p_WB=values(0, seconds),
        v_WB_W=values(1, seconds),
        a_WB_W=values(2, seconds),
    )
    found = sample(window, STAMP + offset_ns)
    at = np.array(offset_ns * 1e-9)
    assert_allclose(found.p_WB, values(0, at), atol=1e-13)
    assert_allclose(found.v_WB_W, values(1, at), atol=1e-13)
    assert_allclose(found.a_WB_W, values(2, at), atol=1e-13)


def _tumble(seconds: Array) -> Rotation:
    return Rotation.from_euler(
        "ZYX",
        np.stack([np.sin(1.3 * seconds), 1.2 * np.sin(2.1 * seconds), 2.0 * seconds], axis=-1),
    )


def _rate(seconds: Array) -> Array:
    """Return the angular velocity of the tumble in the world, by central differences."""
    h = 1e-6
    turn = _tumble(seconds + h) * _tumble(seconds - h).inv()
    return np.asarray(turn.as_rotvec() / (2.0 * h))


def _tumble_error(step_ns: int) -> tuple[float, float]:
    """Return the largest errors of attitude [rad] and body rate [rad/s] half way."""
    offsets = np.arange(0, 2 * SECOND + 1, step_ns)
    window = dataclasses.replace(
        a_window(offsets.tolist()),
        q_WB_xyzw=_tumble(offsets * 1e-9).as_quat(),
        w_WB_W=_rate(offsets * 1e-9),
    )
    between = offsets[:-1] + step_ns // 2
    found, true = sample(window, STAMP + between), _tumble(between * 1e-9)
    off = (true.inv() * Rotation.from_matrix(found.R_WB)).magnitude()
    rate_off = found.w_WB_B - true.inv().apply(_rate(between * 1e-9))
    return float(off.max()), float(np.abs(rate_off).max())


def test_attitude_is_of_fourth_order_between_the_samples() -> None:
    coarse, fine = _tumble_error(100_000_000), _tumble_error(50_000_000)
    assert fine[0] < 2e-5
    assert coarse[0] / fine[0] > 12.0
    assert fine[1] < 5e-3
    assert coarse[1] / fine[1] > 6.0


def test_body_rate_is_the_derivative_of_the_attitude() -> None:
    window = a_window([0, SECOND], seed=7)
    for part in (0.2, 0.7):
        at, h = STAMP + round(part * SECOND), 1000
        before, after = sample(window, at - h).R_WB, sample(window, at + h).R_WB
        turn = Rotation.from_matrix(before.T @ after).as_rotvec()
        assert_allclose(sample(window, at).w_WB_B, turn / (2e-9 * h), atol=1e-5)


@pytest.mark.parametrize("offsets", [[0, 40, 40, 100], [0, 40, 40, 40, 100], [40, 40, 100]])
def test_at_a_jump_the_later_sample_holds(offsets: list[int]) -> None:
    window = a_window([offset * 1_000_000 for offset in offsets])
    left = offsets.index(40)
    right = max(i for i, offset in enumerate(offsets) if offset == 40)
    assert_array_equal(sample(window, STAMP + 40_000_000).p_WB, window.p_WB[right])
    assert_allclose(sample(window, STAMP + 39_999_999).p_WB, window.p_WB[left], atol=1e-6)


@pytest.mark.parametrize("early_ns", [1, SECOND, 10**18])
def test_before_the_window_the_first_sample_holds(early_ns: int) -> None:
    window = a_window([10, SECOND])
    assert_same(sample(window, STAMP + 10 - early_ns), sample(window, STAMP + 10), atol=0.0)


@pytest.mark.parametrize("late_ns", [0, 1, SECOND, 10**18])
def test_from_the_last_sample_on_its_pose_holds_at_rest(late_ns: int) -> None:
    window = a_window([0, 300, SECOND])
    found = sample(window, STAMP + SECOND + late_ns)
    assert_array_equal(found.p_WB, window.p_WB[-1])
    assert_allclose(found.R_WB, Rotation.from_quat(window.q_WB_xyzw[-1]).as_matrix(), atol=1e-15)
    for name in ("v_WB_W", "a_WB_W", "w_WB_B"):
        assert_array_equal(getattr(found, name), np.zeros(3))


def test_a_pose_held_between_equal_samples_has_no_rounding() -> None:
    window = a_window([0, 50_000_000])
    held = dataclasses.replace(
        window,
        **{
            name: np.repeat(getattr(window, name)[:1], 2, axis=0) for name in ("p_WB", "q_WB_xyzw")
        },
        **{name: np.zeros((2, 3)) for name in ("v_WB_W", "a_WB_W", "w_WB_W")},
    )
    found = sample(held, STAMP + np.arange(0, 50_000_000, 777_777))
    assert_array_equal(found.p_WB, np.broadcast_to(window.p_WB[0], found.p_WB.shape))
    assert_array_equal(found.v_WB_W, np.zeros_like(found.v_WB_W))


@pytest.mark.parametrize("shape", [(), (1,), (12,), (3, 4), (0,)])
def test_a_batch_equals_its_elements(shape: tuple[int, ...]) -> None:
    window = a_window([0, 50, 50, 90, 200], seed=3)
    count = math.prod(shape)
    times = STAMP + np.linspace(-30, 240, count).astype(np.int64)
    found = sample(window, times.reshape(shape))
    for name in FIELDS:
        batch = getattr(found, name)
        assert batch.shape[: len(shape)] == shape
        flat = batch.reshape((count, *batch.shape[len(shape) :]))
        for single, time in zip(flat, times, strict=True):
            assert_allclose(single, getattr(sample(window, int(time)), name), atol=1e-15)


def test_stamps_keep_every_nanosecond() -> None:
    # As a float, a stamp of today is known to 256 ns only.
    window = a_window([0, 100])
    window = dataclasses.replace(
        window,
        p_WB=np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]),
        v_WB_W=np.tile([1e7, 2e7, 3e7], (2, 1)),
    )
    near, far = sample(window, STAMP + 1), sample(window, STAMP + 2)
    assert_allclose(far.p_WB - near.p_WB, [0.01, 0.02, 0.03], atol=1e-12)


@settings(deadline=None)
@given(st.lists(st.booleans(), min_size=4, max_size=4), st.integers(0, 3 * SECOND))
def test_signs_of_the_quaternions_do_not_matter(flips: list[bool], offset_ns: int) -> None:
    window = a_window([0, SECOND, 2 * SECOND, 3 * SECOND], seed=5)
    signs = np.where(flips, -1.0, 1.0)[:, None]
    flipped = dataclasses.replace(window, q_WB_xyzw=signs * window.q_WB_xyzw)
    assert_same(sample(flipped, STAMP + offset_ns), sample(window, STAMP + offset_ns), atol=1e-14)

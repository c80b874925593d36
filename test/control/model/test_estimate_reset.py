# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Announced steps of the estimate: a change of coordinates, and nothing else."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from fixtures.windows import window_through
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import state_from_odometry

TURN, STEP_W = 2.5, np.array([3.0, -1.0, 0.5])
RESET = EstimateReset(stamp_ns=10_000_000, turn=TURN, step_W=STEP_W)


def flying(rng: np.random.Generator) -> OdometrySample:
    return OdometrySample(
        stamp_ns=0,
        p_WB=rng.normal(size=3),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(so3.exp(0.5 * rng.normal(size=3))),
        v_WB_B=3.0 * rng.normal(size=3),
        w_WB_B=2.0 * rng.normal(size=3),
    )


def test_reset_transforms_poses_rigidly() -> None:
    rng = np.random.default_rng(0)
    before = flying(rng)
    x, after = state_from_odometry(before), state_from_odometry(RESET.odometry(before))
    R = so3.exp([0.0, 0.0, TURN])
    assert_allclose(after.p_WB, R @ x.p_WB + STEP_W, atol=1e-12)
    assert_allclose(after.R_WB, R @ x.R_WB, atol=1e-12)
    assert_allclose(after.v_WB_W, R @ x.v_WB_W, atol=1e-12)


def test_motion_between_odometries_is_not_part_of_the_reset() -> None:
    """A body that turns and moves evenly for 10 ms, and then other coordinates."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        before = flying(rng)
        x = state_from_odometry(before)
        moved = dataclasses.replace(
            before,
            stamp_ns=RESET.stamp_ns,
            p_WB=x.p_WB + 0.01 * x.v_WB_W,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(x.R_WB @ so3.exp(0.01 * before.w_WB_B)),
        )
        found = EstimateReset.between(before, RESET.odometry(moved))
        assert found.stamp_ns == RESET.stamp_ns
        assert math.remainder(found.turn - TURN, math.tau) == pytest.approx(0.0, abs=1e-5)
        assert_allclose(found.step_W, STEP_W, atol=1e-4)


def test_window_is_unchanged_relative_to_the_vehicle() -> None:
    """Distances, accelerations and rates in body axes are what they were."""
    rng = np.random.default_rng(2)
    t = np.linspace(0.0, 2.0, 9)
    p = np.stack([np.sin(t), np.cos(2.0 * t), t], axis=1)
    window, before = window_through(t, p, yaw=0.3), flying(rng)
    moved, after = RESET.window(window), RESET.odometry(before)

    def seen(window: ReferenceWindow, odometry: OdometrySample) -> list[np.ndarray]:
        R = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        return [
            (window.p_WB - odometry.p_WB) @ R,
            window.v_WB_W @ R,
            window.a_WB_W @ R,
            window.w_WB_W @ R,
            R.T @ so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw),
        ]

    for now, then in zip(seen(window, before), seen(moved, after), strict=True):
        assert_allclose(then, now, atol=1e-12)

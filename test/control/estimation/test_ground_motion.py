"""Filtered motion, in cases with known results."""

from __future__ import annotations

import math

import numpy as np
import pytest

from quad_mpc_ros.control.estimation.ground_motion import MotionFilter
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample


@pytest.mark.parametrize("seed", range(5))
def test_returns_speeds_in_the_world(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R_WB, v_WB_W = so3.exp(rng.normal(size=3)), rng.normal(size=3)
    motion = MotionFilter(9.81)
    odometry = OdometrySample(
        stamp_ns=0,
        p_WB=np.zeros(3),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
        v_WB_B=R_WB.T @ v_WB_W,
        w_WB_B=np.zeros(3),
    )
    motion.follow(odometry, thrust=1.0, duration=0.0, is_flying=False)
    assert motion.now.climb == pytest.approx(v_WB_W[2])
    assert motion.now.aside == pytest.approx(math.hypot(*v_WB_W[:2]))


def test_follows_a_step_with_a_lag_of_a_tenth_of_a_second() -> None:
    motion = MotionFilter(9.81)
    still = OdometrySample.at_rest([0.0, 0.0, 0.0])
    motion.follow(still, thrust=0.0, duration=0.0, is_flying=False)
    moved = OdometrySample.at_rest([3.0, 0.0, 4.0])
    for _ in range(10):
        motion.follow(moved, thrust=1.0, duration=0.02, is_flying=False)
    followed = 1.0 - math.exp(-0.2 / 0.1)
    assert motion.now.height == pytest.approx(4.0 * followed)
    assert motion.now.displacement == pytest.approx(5.0 * followed)
    assert motion.now.lift == pytest.approx(1.0 - math.exp(-0.2 / 0.3))
    for _ in range(100):
        motion.draw_ground(fast=False)
    assert motion.now.rise == pytest.approx(4.0 * followed)


def carried_after(falls: float) -> float | None:
    """Return when a vehicle with 0.7 of its thrust seems carried [s].

    It falls by a share of the acceleration that this thrust leaves.
    """
    motion, climb = MotionFilter(9.81), 0.0
    for k in range(550):
        reduced = k >= 500
        climb -= falls * 0.3 * 9.81 * 0.02 * reduced
        odometry = OdometrySample.at_rest([0.0, 0.0, 1.0])
        odometry.v_WB_B[2] = climb
        thrust = 0.7 if reduced else 1.0
        motion.follow(odometry, thrust=thrust, duration=0.02 if k else 0.0, is_flying=True)
        if motion.now.carried:
            assert reduced
            return 0.02 * (k - 499)
    return None


def test_detects_ground_contact_after_a_quarter_of_a_second_without_fall() -> None:
    """0.12 s until the filtered thrust is below 0.8, and 0.1 s until 0.2 m/s are missing."""
    assert carried_after(0.0) == pytest.approx(0.22, abs=0.03)


@pytest.mark.parametrize(("falls", "carried"), [(0.2, True), (0.45, False), (1.0, False)])
def test_detects_ground_contact_if_fall_is_below_a_third_of_the_expected(
    falls: float, carried: bool
) -> None:
    assert (carried_after(falls) is not None) is carried

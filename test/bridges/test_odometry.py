"""Odometry of incomplete states, and its stamps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.bridges import AXES, SECOND, T0
from numpy.testing import assert_allclose

from quad_mpc_ros.bridges.odometry import OdometryStamps, PoseDifferentiator
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import OdometrySample

New = Callable[[str], Any]


def poses_of_a_turn(w_WB_B: Array, v_WB_W: Array) -> list[OdometrySample]:
    return [
        OdometrySample(
            stamp_ns=i * 10_000_000,
            p_WB=0.01 * i * v_WB_W,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(
                so3.exp([0.0, 0.0, 3.0]) @ so3.exp(0.01 * i * w_WB_B)
            ),
            v_WB_B=np.zeros(3),
            w_WB_B=np.zeros(3),
        )
        for i in range(80)
    ]


@pytest.mark.parametrize("axis", AXES)
def test_poses_of_a_steady_turn_give_its_rates_and_velocity(axis: tuple[float, ...]) -> None:
    w_WB_B, v_WB_W = 4.0 * np.array(axis), np.array([1.0, -2.0, 0.5])
    differentiator = PoseDifferentiator(velocity_too=True)
    found = [differentiator.completed(pose) for pose in poses_of_a_turn(w_WB_B, v_WB_W)]
    assert found[0] is None
    for odometry in found[1:]:  # through the double cover of quaternions as well
        assert odometry is not None
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        assert_allclose(odometry.w_WB_B, w_WB_B, atol=1e-6)
        assert_allclose(R_WB @ odometry.v_WB_B, v_WB_W, atol=1e-6)


def test_a_step_of_the_position_is_no_velocity() -> None:
    still, stepped = poses_of_a_turn(np.zeros(3), np.zeros(3))[:2]
    differentiator = PoseDifferentiator(velocity_too=True)
    differentiator.completed(still)
    object.__setattr__(stepped, "p_WB", np.array([3.0, 0.0, 0.0]))
    odometry = differentiator.completed(stepped)
    assert odometry is not None
    assert_allclose(odometry.v_WB_B, np.zeros(3))


def test_stamps_of_another_clock_become_times_of_arrival() -> None:
    stamps = OdometryStamps(tolerance=0.1)
    assert stamps.stamp(T0 - SECOND // 50, now_ns=T0) == T0 - SECOND // 50
    assert stamps.stamp(7 * SECOND, now_ns=T0 + SECOND // 50) == T0 + SECOND // 50


def test_stamps_never_run_backwards_unless_the_clock_was_set() -> None:
    stamps = OdometryStamps(tolerance=0.1)
    assert stamps.stamp(T0, now_ns=T0) == T0
    assert stamps.stamp(T0, now_ns=T0) is None
    assert stamps.stamp(T0 - 1000, now_ns=T0) is None
    assert stamps.stamp(SECOND, now_ns=SECOND) == SECOND

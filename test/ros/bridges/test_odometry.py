"""Odometry of incomplete states, and its stamps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.bridges import AXES, SECOND, T0
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.ros.bridges.odometry import OdometryStamps, PoseDifferentiator

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


MS = SECOND // 1000
HOUR = 3600 * SECOND


def stamped(clock_ns: int, waits: list[tuple[int, int]]) -> list[int | None]:
    """Return how long after its measurement [ms] each state is said to have been measured.

    ``waits`` are times of measurement [ms] and how long each is on its way [ms]; the stack's clock
    shows ``clock_ns`` less than the node's.
    """
    stamps, found = OdometryStamps(), []
    for at, wait in waits:
        true_ns = T0 + at * MS
        stamp = stamps.stamp(true_ns - clock_ns, now_ns=true_ns + wait * MS)
        found.append(None if stamp is None else (stamp - true_ns) // MS)
    return found


def test_keeps_stamps_of_agreeing_clock() -> None:
    assert stamped(0, [(20 * k, 15) for k in range(50)]) == [0] * 50


def test_stamps_other_clock_by_fastest_arrival() -> None:
    waits = [(20 * k, 10 + 7 * (k % 3)) for k in range(50)]
    assert stamped(HOUR, waits) == [10] * 50


@pytest.mark.parametrize("clock_ns", [0, HOUR])
def test_stamps_delayed_odometry_late_and_next_on_time(clock_ns: int) -> None:
    """It was stamped as new, and what was new as old."""
    before = [(20 * k, 10) for k in range(50)]
    held_up = [(1000 + 20 * k, 310 - 20 * k) for k in range(15)]  # all at once, 0.3 s later
    after = [(1300 + 20 * k, 10) for k in range(50)]
    latency = 0 if clock_ns == 0 else 10
    assert stamped(clock_ns, [*before, *held_up, *after]) == [latency] * 115


@pytest.mark.parametrize("clock_ns", [0, HOUR])
@pytest.mark.parametrize("waited", [90, 270, 3000])
def test_late_first_state_does_not_shift_later_stamps(clock_ns: int, waited: int) -> None:
    found = stamped(clock_ns, [(-waited + 5, waited), *((20 * k, 10) for k in range(1, 50))])
    assert set(found[2:]) == {0 if clock_ns == 0 else 10}
    assert found[1] in (None, 0, 10)


@pytest.mark.parametrize("step", [3, -3])
def test_stack_clock_step_moves_stamps_by_at_most_the_latency(step: int) -> None:
    stamps = OdometryStamps()
    for k in range(200):
        true_ns = T0 + 20 * k * MS
        set_ns = step * SECOND if k >= 100 else 0
        stamp = stamps.stamp(true_ns + set_ns, now_ns=true_ns + 15 * MS)
        assert stamp is not None
        assert 0 <= stamp - true_ns <= 15 * MS


@pytest.mark.parametrize("pace", [0.99, 1.0005, 1.01])  # also of a simulation in real time
def test_follows_drifting_clock(pace: float) -> None:
    stamps = OdometryStamps()
    for k in range(0, 60_000, 20):
        stamp = stamps.stamp(round(k * MS * pace) + HOUR, now_ns=T0 + k * MS)
        assert stamp is not None
        assert abs(stamp - T0 - k * MS) < 2 * MS


def test_stamps_run_backwards_only_if_clock_was_set() -> None:
    stamps = OdometryStamps()
    assert stamps.stamp(T0, now_ns=T0) == T0
    assert stamps.stamp(T0, now_ns=T0) is None
    assert stamps.stamp(T0 - 1000, now_ns=T0) is None
    assert stamps.stamp(SECOND, now_ns=SECOND) == SECOND

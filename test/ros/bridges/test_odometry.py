# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The stamps of odometry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from fixtures.bridges import SECOND, T0

from quad_mpc_ros.ros.bridges.odometry import OdometryStamps

New = Callable[[str], Any]


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

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Conditions of a reset of the estimate."""

from __future__ import annotations

import math

import numpy as np
import pytest

from quad_mpc_ros.control.estimation.estimate_health import EstimateHealth

MS = 1_000_000


def resets(
    *, seconds: float, refused: float = 0.0, at_bounds: bool = False, later: float = math.inf
) -> list[float]:
    """Return when the estimate is reset [s], if a share of the odometries is refused.

    After ``later`` [s] all are refused.
    """
    health, random, times = EstimateHealth(), np.random.default_rng(0), []
    for k in range(round(50 * seconds)):
        if health.fails(
            20 * MS * k,
            duration=0.02,
            refused=bool(random.random() < refused) or 0.02 * k > later,
            at_bounds=at_bounds,
        ):
            times.append(0.02 * k)
    assert health.resets == len(times)
    return times


@pytest.mark.parametrize("refused", [0.0, 0.05, 0.2])
def test_tolerates_occasional_jumps(refused: float) -> None:
    assert resets(seconds=100.0, refused=refused) == []


def test_resets_within_a_second_of_continuous_rejection() -> None:
    assert resets(seconds=0.9, refused=1.0) == [pytest.approx(0.69, abs=0.05)]


def test_resets_once_after_seconds_at_bounds() -> None:
    """A truth beyond the bounds must not make the flight jump every few seconds."""
    first, second = resets(seconds=40.0, at_bounds=True)
    assert first == pytest.approx(3.0, abs=0.1)
    assert second == pytest.approx(first + 30.0, abs=0.1)


def test_resets_are_half_a_minute_apart() -> None:
    rejecting = resets(seconds=40.0, refused=1.0)
    assert np.diff(rejecting) == pytest.approx([30.0], abs=0.1)
    mixed = resets(seconds=40.0, at_bounds=True, later=5.0)
    assert np.diff(mixed) == pytest.approx([30.0], abs=0.1)

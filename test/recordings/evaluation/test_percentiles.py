# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Percentiles are values that were measured."""

from __future__ import annotations

import math

import pytest

from quad_mpc_ros.recordings.evaluation.percentiles import percentiles


@pytest.mark.parametrize("count", [1, 2, 3, 10, 19, 20, 21, 60, 100, 333])
@pytest.mark.parametrize("percent", [1, 5, 50, 90, 95, 99])
def test_percentile_is_the_smallest_value_not_exceeded_by_its_share(
    count: int, percent: int
) -> None:
    values = [math.sin(17.0 * k) for k in range(count)]
    found = percentiles(values, percent)[f"p{percent}"]
    assert found in values
    assert 100 * sum(value <= found for value in values) >= percent * count
    below = [value for value in values if value < found]
    assert 100 * len(below) < percent * count


def test_nonfinite_values_are_ignored() -> None:
    assert percentiles([1.0, math.nan, 3.0, math.inf], 50) == {"p50": 1.0, "max": 3.0}
    assert percentiles([math.nan], 50) == {"p50": None, "max": None}

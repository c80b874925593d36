# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Compiled functions that the tests of so3 do not cover."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.control.lie import kernels


@pytest.mark.parametrize(
    ("values", "expected"),
    [([], 0.0), ([1.0, -3.0, 2.0], 3.0), ([0.0, -np.inf], np.inf)],
)
def test_largest_magnitude(values: list[float], expected: float) -> None:
    assert kernels.infinity_norm(np.array(values)) == expected


@pytest.mark.parametrize("place", [0, 1, 2])
def test_largest_magnitude_is_nan_if_any_is_nan(place: int) -> None:
    values = np.array([5.0, np.inf, -7.0])
    values[place] = np.nan
    assert np.isnan(kernels.infinity_norm(values))

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A reference made of a plain function: derivatives, yaw, period, and refused functions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros import FunctionPath, simulate, summarise
from quad_mpc_ros.configuration import ArgumentError


def circle(t: float) -> tuple[float, float, float]:
    return 2.0 * math.cos(t), 2.0 * math.sin(t), 3.0


def test_derivatives_are_those_of_the_function() -> None:
    path = FunctionPath(circle, duration=math.tau, periodic=True)
    t = np.linspace(0.0, 20.0, 333)
    found = path.at(t)
    up = np.zeros_like(t)
    assert path.periodic and path.duration == math.tau
    assert_allclose(found.p_WB, np.stack((2 * np.cos(t), 2 * np.sin(t), up + 3), 1), atol=1e-9)
    assert_allclose(found.v_WB_W, np.stack((-2 * np.sin(t), 2 * np.cos(t), up), 1), atol=1e-8)
    assert_allclose(found.a_WB_W, np.stack((-2 * np.cos(t), -2 * np.sin(t), up), 1), atol=1e-6)
    assert_allclose(found.j_WB_W, np.stack((2 * np.sin(t), -2 * np.cos(t), up), 1), atol=1e-4)


def test_the_fourth_number_is_the_yaw() -> None:
    path = FunctionPath(lambda t: [0.0, 0.0, 2.0, 0.1 * t], duration=4.0)
    found = path.at(np.array([1.0, 3.0]))
    assert not path.periodic
    assert_allclose(found.yaw, [0.1, 0.3], atol=1e-9)
    assert_allclose(found.yaw_rate, [0.1, 0.1], atol=1e-9)


def test_is_flown() -> None:
    path = FunctionPath(circle, duration=math.tau, periodic=True)
    flight = simulate(trajectory=path, on_reference=True, duration=3.0)
    assert summarise(flight)["position_rmse_m"] < 0.01


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda t: (t, t), "expected 3 or 4 finite numbers"),
        (lambda t: (t, math.nan, 2.0), "expected 3 or 4 finite numbers"),
        (lambda t: (t, 0.0, 2.0), "expected the values at t = 0"),
    ],
)
def test_refuses_a_function_that_is_no_path(function: object, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        FunctionPath(function, duration=1.0, periodic=True)  # type: ignore[arg-type]

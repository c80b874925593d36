# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The share of the body rates that a rate loop explains."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lsim

from quad_mpc_ros.control.estimation.loop_rates import (
    LoopRates,
    follow_loops,
    start_loops,
    unexplained,
)

PERIOD = 0.02
UNBOUNDED = math.inf, math.inf, math.inf
Loop = tuple[float, float]


def unexplained_after(duration: float, assumed: Loop, true: Loop) -> float:
    """Return the unexplained share of the rates of a true loop; loops are (tau, T) [s]."""
    random = np.random.default_rng(0)
    command = np.repeat(random.uniform(-3.0, 3.0, (25, 3)), 10, axis=0)
    time = PERIOD * np.arange(len(command))
    loop = ([1.0], [true[0] * true[1], true[0], 1.0])
    rates = np.column_stack([lsim(loop, command[:, k], time, interp=False)[1] for k in range(3)])
    memory, loops = LoopRates.zeros(), np.array([[assumed] * 3])
    start_loops(memory[()], tuple(rates[0]))
    for acted, w in zip(command, rates[1 : round(duration / PERIOD)], strict=False):
        follow_loops(memory[()], loops, acted, tuple(w), UNBOUNDED, PERIOD)
    return unexplained(memory[()])


@pytest.mark.parametrize("true", [(0.07, 0.02), (0.04, 0.16), (0.4, 0.2)])
def test_the_true_loop_explains_all_rates(true: Loop) -> None:
    assert unexplained_after(2.0, true, true) < 1e-3


@pytest.mark.parametrize("true", [(0.04, 0.16), (0.4, 0.2)])
def test_another_loop_leaves_rates_unexplained_within_half_a_second(true: Loop) -> None:
    assert unexplained_after(0.5, (0.07, 0.02), true) > 0.2

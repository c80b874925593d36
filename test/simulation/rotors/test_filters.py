# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The filters against those of scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

from quad_mpc_ros.simulation.rotors import rate_loop


@pytest.mark.parametrize("cutoff", [10.0, 80.0, 240.0])
def test_the_butterworth_is_that_of_scipy(cutoff: float) -> None:
    values = np.random.default_rng(0).standard_normal(200)
    section, held = rate_loop.butterworth(cutoff, 500.0)[()], np.zeros(2)
    mine = [rate_loop.filtered(value, section=section, held=held) for value in values]
    assert_allclose(mine, signal.lfilter(*signal.butter(2, cutoff, fs=500.0), values), atol=1e-12)


@pytest.mark.parametrize("cutoff", [0.0, 30.0])
def test_settled_filter_passes_a_constant(cutoff: float) -> None:
    section, held = rate_loop.butterworth(cutoff, 500.0)[()], np.zeros(2)
    rate_loop.initialize(3.7, section=section, held=held)
    assert_allclose([rate_loop.filtered(3.7, section=section, held=held) for _ in range(5)], 3.7)


def test_smoothing_reaches_63_percent_after_its_time_constant() -> None:
    cutoff, rate, value = 5.0, 1000.0, 0.0
    for _ in range(round(rate / (2.0 * math.pi * cutoff))):
        value += rate_loop.smoothing(cutoff, rate) * (1.0 - value)
    assert value == pytest.approx(1.0 - math.exp(-1.0), abs=0.01)

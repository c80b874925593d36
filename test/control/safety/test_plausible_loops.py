# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Rate loops that ring or are slow explain body rates; reversed and swapped axes do not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lsim

from quad_mpc_ros.control.estimation.loop_rates import follow_loops, start_loops
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.safety.plausible_loops import (
    PLAUSIBLE_LOOPS,
    PlausibleRates,
    are_explained,
)

PERIOD = 0.02


def random_commands(seed: int, largest: float = 3.0) -> Array:
    """Return 5 s of commands (250, 3) that change a few times a second [rad/s]."""
    random = np.random.default_rng(seed)
    return np.repeat(random.uniform(-largest, largest, (25, 3)), 10, axis=0)


def share_of_loop(tau: float, lag: float, mixed: Array, seed: int) -> float:
    """Return the explained share of the rates of a loop, mixed by a matrix, 20 ms late."""
    random, command = np.random.default_rng(seed), random_commands(seed)
    time = PERIOD * np.arange(len(command))
    loop = ([1.0], [tau * lag, tau, 1.0])
    late = np.vstack((np.zeros((1, 3)), command[:-1]))
    rates = np.column_stack([lsim(loop, late[:, k], time)[1] for k in range(3)])
    rates = rates @ mixed.T + random.normal(0.0, 0.02, rates.shape)
    return share_explained(command, rates, math.inf)


def share_explained(command: Array, rates: Array, most: float) -> float:
    """Return the share of the time after 1 s in which rates are explained; ``most``: bound."""
    memory = PlausibleRates.zeros()
    state = memory[()]
    start_loops(state, tuple(rates[0]))
    explained = []
    for acted, w in zip(command[:-1], rates[1:], strict=True):
        follow_loops(state, PLAUSIBLE_LOOPS, acted, tuple(w), (most, most, most), PERIOD)
        explained.append(are_explained(state))
    return float(np.mean(explained[50:]))


def saturated_rates(command: Array, most: float) -> Array:
    """Return the rates of a slow loop, 0.27 s and 0.13 s, with a bounded demand [rad/s^2]."""
    rate, acceleration, rates = np.zeros(3), np.zeros(3), [np.zeros(3)]
    for acted in command[:-1]:
        for _ in range(20):
            demand = np.clip((acted - rate) / 0.27, -most, most)
            acceleration = acceleration + 1e-3 * (demand - acceleration) / 0.13
            rate = rate + 1e-3 * acceleration
        rates.append(rate)
    return np.array(rates)


@pytest.mark.parametrize("lag", [0.03, 0.06, 0.1, 0.2])
@pytest.mark.parametrize("tau", ["ringing", "slow"])
def test_explains_loops_that_ring_or_are_slow(tau: str, lag: float) -> None:
    for seed in range(2):
        constant = 0.04 if tau == "ringing" else 2.0 * lag
        assert share_of_loop(constant, lag, np.eye(3), seed) > 0.95


@pytest.mark.parametrize(
    "mixed",
    [
        np.diag([-1.0, 1.0, 1.0]),
        np.diag([1.0, 1.0, -1.0]),
        np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    ],
    ids=["roll reversed", "yaw reversed", "roll and pitch swapped"],
)
def test_does_not_explain_wrong_axes(mixed: Array) -> None:
    for seed in range(2):
        assert share_of_loop(0.07, 0.02, mixed, seed) < 0.05


def test_explains_saturated_rotors_with_the_bound_of_the_vehicle_alone() -> None:
    for seed in range(3):
        command = random_commands(seed, largest=6.0)
        rates = saturated_rates(command, 4.0)
        assert share_explained(command, rates, 4.0) > 0.95
        assert share_explained(command, rates, 8.0) > 0.5
        assert share_explained(command, rates, math.inf) < 0.8
        assert share_explained(command, -rates, 4.0) < 0.05

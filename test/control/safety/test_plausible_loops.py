"""Rate loops that ring or are slow explain body rates; reversed and swapped axes do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.safety.plausible_loops import (
    PlausibleRates,
    are_explained,
    follow_loops,
    start_loops,
)

PERIOD = 0.02


def shares_explained(tau: float, lag: float, mixed: Array, seed: int) -> float:
    """Return the share of 5 s in which the rates of a loop, mixed by a matrix, are explained.

    Commands of up to 3 rad/s change a few times a second; the loop has its own delay of 20 ms.
    """
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(-3.0, 3.0, (25, 3)), 10, axis=0)
    time = PERIOD * np.arange(len(command))
    loop = ([1.0], [tau * lag, tau, 1.0])
    late = np.vstack((np.zeros((1, 3)), command[:-1]))
    rates = np.column_stack([lsim(loop, late[:, k], time)[1] for k in range(3)])
    rates = rates @ mixed.T + random.normal(0.0, 0.02, rates.shape)
    memory = PlausibleRates.zeros()
    state = memory[()]
    start_loops(state, tuple(rates[0]))
    explained = []
    for acted, w in zip(command[:-1], rates[1:], strict=True):
        follow_loops(state, acted, tuple(w), PERIOD)
        explained.append(are_explained(state))
    return float(np.mean(explained[50:]))


@pytest.mark.parametrize("lag", [0.03, 0.06, 0.1, 0.2])
@pytest.mark.parametrize("tau", ["ringing", "slow"])
def test_explains_loops_that_ring_or_are_slow(tau: str, lag: float) -> None:
    for seed in range(2):
        constant = 0.04 if tau == "ringing" else 2.0 * lag
        assert shares_explained(constant, lag, np.eye(3), seed) > 0.95


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
        assert shares_explained(0.07, 0.02, mixed, seed) < 0.05

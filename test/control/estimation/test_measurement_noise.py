# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""White noise is separated from unmodelled motion and from drift."""

from __future__ import annotations

import math

import numpy as np
import pytest

from quad_mpc_ros.control.estimation import measurement_noise
from quad_mpc_ros.control.estimation.measurement_noise import VelocityDrift, WhiteNoise
from quad_mpc_ros.control.lie import Array

PERIOD = 0.02


def found(velocity_errors: Array, least: float = measurement_noise.USUAL) -> float:
    """Return the estimated noise of velocities with errors (n, 3), otherwise as predicted."""
    noise = WhiteNoise.zeros()[()]
    measurement_noise.start(noise, least)
    for change in np.diff(velocity_errors, axis=0):
        measurement_noise.update_white_noise(noise, tuple(change.tolist()), PERIOD)
    return math.sqrt(measurement_noise.variance_in(noise))


@pytest.mark.parametrize("sigma", [0.1, 0.2, 0.5])
def test_estimates_white_noise(sigma: float) -> None:
    errors = sigma * np.random.default_rng(1).normal(size=(1000, 3))
    assert found(errors) == pytest.approx(sigma, rel=0.15)


def test_unmodelled_acceleration_is_not_noise() -> None:
    seconds = PERIOD * np.arange(1000)
    moving = np.column_stack([np.sin(5.0 * seconds), 3.0 * seconds, np.zeros(1000)])
    assert found(moving) == measurement_noise.USUAL


@pytest.mark.parametrize("least", [0.01, 0.05])
def test_noise_has_a_lower_bound(least: float) -> None:
    assert found(np.zeros((500, 3)), least) == least
    assert found(0.03 * np.random.default_rng(4).normal(size=(500, 3)), least) == pytest.approx(
        max(0.03, least), rel=0.2
    )


def test_single_jump_hardly_raises_noise() -> None:
    errors = 0.1 * np.random.default_rng(2).normal(size=(1000, 3))
    errors[-5:] += 2.0
    assert found(errors) < 0.15


def test_follows_rising_noise() -> None:
    random = np.random.default_rng(3)
    errors = random.normal(size=(400, 3)) * np.where(np.arange(400) < 300, 0.05, 0.4)[:, None]
    assert found(errors) > 0.25


def drift_found(p: Array, v: Array, *, white: float) -> float:
    """Return the estimated drift of velocities (n, 3) along positions (n, 3)."""
    drift = VelocityDrift.zeros()[()]
    measurement_noise.start_drift(drift)
    measurement_noise.begin_drift(drift, p[0], v[0])
    for position, velocity in zip(p[1:], v[1:], strict=True):
        measurement_noise.update_drift(drift, position, velocity, white**2, PERIOD)
    return math.sqrt(measurement_noise.drift_variance_in(drift, 0.0))


def drifting(deviation: float, seed: int) -> Array:
    """Return a Gauss-Markov process (n, 3) that is correlated over a second."""
    random, kept = np.random.default_rng(seed), math.exp(-PERIOD)
    errors = [deviation * random.normal(size=3)]
    for _ in range(999):
        fresh = deviation * math.sqrt(1.0 - kept**2) * random.normal(size=3)
        errors.append(kept * errors[-1] + fresh)
    return np.array(errors)


@pytest.mark.parametrize("deviation", [0.1, 0.3, 0.5])
def test_estimates_drift_by_the_position(deviation: float) -> None:
    p = 0.003 * np.random.default_rng(5).normal(size=(1000, 3))
    found = [drift_found(p, drifting(deviation, seed), white=0.003) for seed in range(20)]
    assert np.mean(found) == pytest.approx(deviation, rel=0.25)


def test_clean_odometry_has_no_drift() -> None:
    seconds = PERIOD * np.arange(1000)[:, None]
    random = np.random.default_rng(6)
    p = 3.0 * np.sin(2.0 * seconds) + 0.003 * random.normal(size=(1000, 3))
    v = 6.0 * np.cos(2.0 * seconds) + 0.05 * random.normal(size=(1000, 3))
    assert drift_found(p, v, white=0.003) < 0.03

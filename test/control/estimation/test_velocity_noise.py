"""The noise of a velocity is separated from accelerations that the model lacks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from quad_mpc_ros.control.estimation import velocity_noise
from quad_mpc_ros.control.estimation.velocity_noise import VelocityNoise
from quad_mpc_ros.control.lie import Array

PERIOD = 0.02


def found(velocity_errors: Array, least: float = velocity_noise.USUAL) -> float:
    """Return the noise found of errors (n, 3) of successive velocities, otherwise as predicted."""
    noise = VelocityNoise.zeros()[()]
    velocity_noise.start(noise, least)
    for change in np.diff(velocity_errors, axis=0):
        velocity_noise.follow(noise, tuple(change.tolist()), PERIOD)
    return math.sqrt(velocity_noise.variance_in(noise))


@pytest.mark.parametrize("sigma", [0.1, 0.2, 0.5])
def test_estimates_white_noise(sigma: float) -> None:
    errors = sigma * np.random.default_rng(1).normal(size=(1000, 3))
    assert found(errors) == pytest.approx(sigma, rel=0.15)


def test_unmodelled_acceleration_is_not_noise() -> None:
    seconds = PERIOD * np.arange(1000)
    moving = np.column_stack([np.sin(5.0 * seconds), 3.0 * seconds, np.zeros(1000)])
    assert found(moving) == velocity_noise.USUAL


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

"""A velocity that disagrees with how the position moves: found, and no more than that."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.records import changed

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation import velocity_bias
from quad_mpc_ros.control.estimation.velocity_bias import VelocityBias
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

PERIOD = 0.02
TIME = np.arange(0.0, 8.0, PERIOD)


def started(*, enabled: bool = True) -> VelocityBias:
    return changed(VelocityBias.zeros()[()], enabled=enabled)


def followed(p: Array, v: Array) -> Array:
    """Return the bias (n, 3) that is taken off velocities (n, 3) along positions (n, 3)."""
    bias, corrected = started(), v.copy()
    for k in range(len(p)):
        duration = PERIOD if k else 0.0
        velocity_bias.correct(bias, p_WB=p[k], v_WB_W=corrected[k], duration=duration)
    return v - corrected


def circling(frequency: float = 2.0) -> tuple[Array, Array]:
    phase = frequency * TIME
    p = np.column_stack((3.0 * np.sin(phase), 3.0 * np.cos(phase), np.full_like(phase, 2.0)))
    v = 3.0 * frequency * np.column_stack((np.cos(phase), -np.sin(phase), 0.0 * phase))
    return p, v


def test_finds_constant_bias_within_seconds() -> None:
    p, v = circling()
    bias = followed(p, v + np.array([0.3, -0.2, 0.1]))
    assert np.abs(bias[TIME > 3.0] - [0.3, -0.2, 0.1]).max() < 0.01


def test_consistent_velocity_has_no_bias() -> None:
    assert np.abs(followed(*circling())).max() < 1e-3


def test_position_jump_causes_no_bias() -> None:
    p, v = circling()
    p[200:] += [2.0, 0.0, 0.0]
    assert np.abs(followed(p, v)).max() < 1e-3


def test_position_noise_is_filtered() -> None:
    p, v = circling()
    noisy = p + 0.01 * np.random.default_rng(1).normal(size=p.shape)
    assert followed(noisy, v)[100:].std(axis=0).max() < 0.008


def test_bias_is_bounded() -> None:
    p, v = circling()
    assert np.abs(followed(p, v + np.array([3.0, 0.0, 0.0]))).max() <= 1.0


def test_disabled_bias_keeps_velocity() -> None:
    bias = started(enabled=False)
    for position in np.arange(0.0, 1.0, 0.01):
        v = np.array([0.3, -0.2, 0.1])
        velocity_bias.correct(bias, p_WB=np.array([position, 0.0, 0.0]), v_WB_W=v, duration=PERIOD)
        np.testing.assert_array_equal(v, [0.3, -0.2, 0.1])


@pytest.mark.parametrize("trajectory", ["hover", "lemniscate"])
def test_biased_velocity_causes_no_position_error(trajectory: str) -> None:
    """By 0.3 m/s without it a default controller is 0.16 m off."""
    simulator = SimulatorConfig(velocity_bias=(0.3, 0.0, 0.0), duration=10.0)
    steps = fly(
        mpc=MpcConfig(),
        simulator=simulator,
        reference=ReferenceConfig(trajectory=trajectory, height=2.0),
        on_reference=True,
    )
    error = [np.linalg.norm(each.truth.p_WB - each.window.p_WB[0]) for each in steps]
    assert max(error[-250:]) < 0.04

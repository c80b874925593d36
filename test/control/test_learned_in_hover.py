# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Hover in wind with more or less thrust than modelled, among noise: what is learned is true.

In a hover the scale of the thrust and a vertical disturbance look alike; nothing pushes up here.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

LAGS: dict[str, Any] = {"rate_time_constant": 0.04, "thrust_time_constant": 0.04}
ROBUST: dict[str, Any] = {**LAGS, "horizon_steps": 20, "R": (0.0, 0.1, 0.1, 0.1)}
SETTLING, DURATION = 5.0, 20.0


class Learned(NamedTuple):
    """Estimates over the ticks (n,) after convergence, and the mean thrust axis (3,)."""

    scale: Array
    a_W: Array
    rate_lag: Array
    thrust_lag: Array
    status: set[str]
    up: Array


def hovering(mpc: MpcConfig, **simulator: Any) -> Learned:
    config = SimulatorConfig(
        duration=DURATION,
        command_delay=0.03,
        position_noise=0.003,
        initial_position=(0.0, 0.0, 2.0),
        initial_throttle=0.35,
        **simulator,
    )
    converged = [
        (step.tick.stats, step.truth)
        for step in fly(mpc=mpc, simulator=config, reference=ReferenceConfig(trajectory="hover"))
        if step.tick is not None and step.truth.stamp_ns > 1e9 * (1.0 + SETTLING)
    ]
    stats = [each for each, _ in converged]
    axes = [so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw)[:, 2] for _, truth in converged]
    return Learned(
        scale=np.array([each.thrust_scale for each in stats]),
        a_W=np.array([(e.disturbance_x, e.disturbance_y, e.disturbance_z) for e in stats]),
        rate_lag=np.array([each.rate_time_constant_ms for each in stats]),
        thrust_lag=np.array([each.thrust_time_constant_ms for each in stats]),
        status={each.estimate for each in stats},
        up=np.mean(axes, axis=0),
    )


@pytest.mark.parametrize(
    ("scale", "wind", "noise"),
    [
        (0.7, (4.0, 0.0, 0.0), 0.02),
        (0.7, (2.8, -2.8, 0.0), 0.2),
        (1.0, (0.0, 0.0, 0.0), 0.2),
        (1.3, (0.0, 0.0, 0.0), 0.02),
        (1.3, (0.0, 4.0, 0.0), 0.2),
    ],
)
def test_estimates_thrust_scale_and_wind_in_hover(
    scale: float, wind: tuple[float, float, float], noise: float
) -> None:
    mpc = MpcConfig(**ROBUST, input_delay=0.03)
    learned = hovering(mpc, **LAGS, thrust_scale=scale, wind=wind, velocity_noise=noise)
    pushed = SimulatorConfig().drag * np.array(wind)
    np.testing.assert_allclose(learned.scale, scale, atol=0.1)
    np.testing.assert_allclose(learned.a_W.mean(axis=0), pushed, atol=0.3)
    off = np.linalg.norm(learned.a_W - pushed, axis=1)
    assert np.percentile(np.abs(learned.a_W - pushed), 99.0) < 0.5
    assert np.sqrt(np.mean(off**2)) < (0.15 if noise < 0.1 else 0.4)
    assert not learned.status & {"at bounds", "reset"}
    assert 38.0 < learned.rate_lag.min() <= learned.rate_lag.max() < 42.0
    assert 18.0 < learned.thrust_lag.min() <= learned.thrust_lag.max() < 80.0


def test_estimates_thrust_scale_and_wind_of_rotor_plant() -> None:
    """Its lateral force in wind follows from how it has to lean."""
    pytest.importorskip("rotorpy")
    mpc = MpcConfig(**{**ROBUST, "rate_time_constant": 0.05}, input_delay=0.03)
    wind = (3.0, 0.0, 0.0)
    learned = hovering(mpc, plant="rotorpy", wind=wind, velocity_noise=0.2)
    leaning = -SimulatorConfig().gravity * learned.up[:2] / learned.up[2]
    assert leaning[0] > 0.2
    np.testing.assert_allclose(learned.scale, 1.0, atol=0.1)
    np.testing.assert_allclose(learned.a_W[:, :2].mean(axis=0), leaning, atol=0.15)
    assert np.percentile(np.abs(learned.a_W[:, :2] - leaning), 99.0) < 0.5
    assert not learned.status & {"at bounds", "reset"}

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Odometry of an autopilot's estimator: good positions, velocity errors over a second."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

SETTLED = 5.0  # s


@pytest.mark.parametrize(
    ("trajectory", "drift", "mean"), [("lemniscate", 0.3, 0.05), ("hover", 0.5, 0.1)]
)
def test_a_velocity_error_over_a_second_costs_centimetres(
    trajectory: str, drift: float, mean: float
) -> None:
    """A filter without the position had errors of 17 cm and 65 cm and used the fallback."""
    simulator = SimulatorConfig(
        plant="rotors",
        velocity_drift=drift,
        position_noise=0.003,
        attitude_noise=0.003,
        velocity_noise=0.02,
        rate_noise=0.02,
        duration=12.0,
        initial_position=(0.0, 0.0, 2.0),
    )
    errors = []
    for step in fly(
        mpc=MpcConfig(),
        simulator=simulator,
        reference=ReferenceConfig(trajectory=trajectory, height=2.0, angular_frequency=1.2),
        on_reference=True,
    ):
        if step.truth.stamp_ns > 1e9 * (1.0 + SETTLED):
            assert step.tick is None or step.tick.stats.source == "mpc"
            errors.append(float(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0])))
    assert np.mean(errors) < mean


def test_a_constant_velocity_error_causes_no_position_error() -> None:
    """Without the position, an error of 0.3 m/s would cost 0.16 m."""
    steps = fly(
        mpc=MpcConfig(),
        simulator=SimulatorConfig(velocity_bias=(0.3, 0.0, 0.0), duration=10.0),
        reference=ReferenceConfig(trajectory="lemniscate", height=2.0),
        on_reference=True,
    )
    error = [np.linalg.norm(each.truth.p_WB - each.window.p_WB[0]) for each in steps]
    assert max(error[-250:]) < 0.04

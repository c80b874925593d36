# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A correlated error of the odometry's velocity: a first-order Gauss-Markov process."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from fixtures.presets import ideal

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.simulation.sensors import Sensors

PERIOD_NS, COUNT = 20_000_000, 20_000
DEVIATION, TIME = 0.3, 1.0


def errors_in_the_world(seed: int = 0) -> np.ndarray:
    """Return the errors (n, 3) of a velocity of a vehicle that leans."""
    sensors = Sensors(ideal({"velocity_drift": DEVIATION, "seed": seed}))
    q = so3.quaternion_xyzw_from_rotation(so3.exp([0.3, -0.4, 1.0]))
    truth = OdometrySample(
        stamp_ns=0, p_WB=np.zeros(3), q_WB_xyzw=q, v_WB_B=np.ones(3), w_WB_B=np.zeros(3)
    )
    R_WB, found = so3.rotation_from_quaternion_xyzw(q), []
    for k in range(COUNT):
        measured = sensors.measured(dataclasses.replace(truth, stamp_ns=k * PERIOD_NS))
        np.testing.assert_array_equal(measured.p_WB, truth.p_WB)
        found.append(R_WB @ (measured.v_WB_B - truth.v_WB_B))
    return np.array(found)


def test_drift_has_its_deviation_and_its_correlation() -> None:
    errors = errors_in_the_world()
    np.testing.assert_allclose(errors.std(axis=0), DEVIATION, rtol=0.1)
    np.testing.assert_allclose(errors.mean(axis=0), 0.0, atol=0.2 * DEVIATION)
    for lag in (1, 10, 25):
        correlation = np.mean(errors[lag:] * errors[:-lag], axis=0) / errors.var(axis=0)
        expected = np.exp(-lag * 1e-9 * PERIOD_NS / TIME)
        np.testing.assert_allclose(correlation, expected, atol=0.1)
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.15


@pytest.mark.parametrize("name", ["velocity_noise", "position_noise"])
def test_drift_changes_no_other_noise(name: str) -> None:
    truth = OdometrySample.at_rest([0.0, 0.0, 1.0])
    alone, both = (Sensors(ideal({name: 0.1, "velocity_drift": d})) for d in (0.0, DEVIATION))
    np.testing.assert_array_equal(alone.measured(truth).p_WB, both.measured(truth).p_WB)

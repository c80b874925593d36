# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The sweeps stay within every bound that was asked for, and excite every axis."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.trajectory import TrajectorySamples

STEP = 0.002  # s
CASES: dict[str, dict[str, object]] = {
    "defaults": {},
    "small room": {"excitation_reach": [0.5, 0.8, 0.3], "origin": [3.0, -1.0], "height": 0.5},
    "slow": {"excitation_speed": 0.8, "excitation_tilt": 0.3},
    "wide": {"excitation_reach": [20.0, 10.0, 5.0], "excitation_duration": 60.0},
    "steep": {"excitation_tilt": 1.0, "excitation_speed": 6.0},
    "much air": {"drag": [0.8, 0.8, 0.8], "yaw": 2.0, "excitation_duration": 30.0},
}


def flown(**changes: object) -> tuple[ReferenceConfig, TrajectorySamples, Array]:
    """Return the configuration, samples every 2 ms, and their rotations."""
    config = ReferenceConfig.build({"trajectory": "excitation", **changes})
    trajectory = configured_trajectory(config)
    samples = trajectory.at(list(range(0, trajectory.period_ns, round(1e9 * STEP))))
    return config, samples, so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)


def body_rates(samples: TrajectorySamples, R_WB: Array) -> Array:
    return np.einsum("nji,nj->ni", R_WB, samples.w_WB_W)


@pytest.mark.parametrize("case", CASES)
def test_stays_within_reach_speed_tilt_and_yaw(case: str) -> None:
    config, samples, R_WB = flown(**CASES[case])
    reach = np.array(config.excitation_reach)
    assert samples.p_WB[:, 2].min() == pytest.approx(config.height, abs=1e-3)
    assert samples.p_WB[:, 2].max() <= config.height + 2.0 * reach[2]
    aside = np.abs(samples.p_WB[:, :2] - np.array(config.origin)).max(axis=0)
    assert np.all(aside <= reach[:2])
    # The derivatives of the spline overshoot those of the samples that it was made of, by little.
    little = 1.01
    assert np.abs(samples.v_WB_W).max() <= little * config.excitation_speed
    most = little * 0.3 * config.gravity
    assert np.abs(samples.a_WB_W[:, 2]).max() <= most
    assert np.arccos(R_WB[:, 2, 2]).max() <= little * config.excitation_tilt
    yaw_rate = np.abs(body_rates(samples, R_WB)[:, 2]).max()
    assert yaw_rate <= 0.8


@pytest.mark.parametrize("case", CASES)
def test_ends_in_its_initial_state(case: str) -> None:
    _, samples, R_WB = flown(**CASES[case])
    assert_allclose(samples.p_WB[-1], samples.p_WB[0], atol=1e-3)
    assert_allclose(R_WB[-1], R_WB[0], atol=0.01)


def test_every_axis_has_slow_and_fast_oscillations() -> None:
    """Of each a tenth of the power lies below 0.5 Hz, and of x, y, z a twentieth above 1 Hz."""
    _, samples, R_WB = flown()
    courses = np.column_stack((samples.a_WB_W, 2.0 * body_rates(samples, R_WB)[:, 2]))
    power = np.abs(np.fft.rfft(courses, axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(courses), STEP)
    share = power / power.sum(axis=0)
    assert np.all(share[frequency < 0.5].sum(axis=0) > 0.1)
    assert np.all(share[frequency > 1.0, :3].sum(axis=0) > 0.05)
    # And no two of them are alike: one would be taken for the other.
    assert np.abs(np.corrcoef(courses.T) - np.eye(4)).max() < 0.25

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Paths that are given as a thrust: Newton's law along them, from nothing but positions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory


@pytest.mark.parametrize("rotors", [0.0, 0.3])
def test_newtons_law_holds_through_a_flip(rotors: float) -> None:
    config = ReferenceConfig(trajectory="flip", drag=0.2, rotor_drag=rotors)
    trajectory = configured_trajectory(config)
    step_ns = 1_000_000
    middle = np.arange(2 * step_ns, trajectory.period_ns - 2 * step_ns, 20 * step_ns)
    before, at, after = (
        trajectory.at((middle + shift).tolist()) for shift in (-step_ns, 0, step_ns)
    )
    v = (after.p_WB - before.p_WB) / 2e-3
    a = (after.p_WB - 2.0 * at.p_WB + before.p_WB) / 1e-6
    x, y, z, w = at.q_WB_xyzw.T
    up = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    force = a + [0.0, 0.0, config.gravity] + config.drag * v
    # T = z'f + nu sqrt(T / g) z'v, by iteration.
    thrust = np.sum(up * force, axis=1)
    for _ in range(50):
        speed = np.sqrt(np.maximum(thrust, 0.0) / config.gravity)
        thrust = np.sum(up * (force + rotors * speed[:, None] * v), axis=1)
    left = force + rotors * speed[:, None] * v - thrust[:, None] * up
    assert_allclose(left, 0.0, atol=0.02)

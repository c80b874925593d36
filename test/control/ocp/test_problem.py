# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The cost's gradient and Gauss-Newton matrix, by finite differences through ⊞."""

from __future__ import annotations

import numpy as np
from fixtures.records import changed

from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.target import TargetStage
from quad_mpc_ros.control.ocp.problem import tracking_cost, write_tracking_cost
from quad_mpc_ros.control.ocp.settings import ProblemSettings

STEPS = 3
RNG = np.random.default_rng(2)
SETTINGS = changed(
    ProblemSettings.zeros()[()],
    Q=[10.0, 9.0, 8.0, 1.0, 2.0, 3.0, 0.5, 0.7, 0.9],
    R=[0.1, 0.001, 0.002, 0.003],
    terminal_weight=30.0,
)
TARGET = TargetStage.zeros(STEPS)
TARGET["p_WB"], TARGET["v_WB_W"] = RNG.normal(size=(STEPS, 3)), RNG.normal(size=(STEPS, 3))
TARGET["R_WB"] = so3.exp(RNG.normal(size=(STEPS, 3)))

STATES = StateRecord.zeros(STEPS + 1)
STATES["p_WB"], STATES["v_WB_W"] = RNG.normal(size=(2, STEPS + 1, 3))
STATES["R_WB"] = so3.exp(1.5 * RNG.normal(size=(STEPS + 1, 3)))
DEVIATION = RNG.normal(size=(STEPS, 4))


def cost_and_errors(states: RecordArray[StateRecord]) -> tuple[float, Array]:
    errors = np.zeros((STEPS, 9))
    return tracking_cost(SETTINGS, SETTINGS.R, states, TARGET, DEVIATION, errors), errors


def moved(stage: int, step: Array) -> RecordArray[StateRecord]:
    states = STATES.copy()
    state = states[stage + 1]
    state.p_WB[:] += step[0:3]
    state.v_WB_W[:] += step[3:6]
    state.R_WB[:] = state.R_WB @ so3.exp(step[6:9])
    return states


def test_gradient_and_gauss_newton_matrix() -> None:
    h = 1e-6
    _, errors = cost_and_errors(STATES)
    H, g = np.zeros((STEPS, 9, 9)), np.zeros((STEPS, 9))
    write_tracking_cost(SETTINGS, errors, H, g)
    for stage in range(STEPS):
        ahead = [cost_and_errors(moved(stage, h * e)) for e in np.eye(9)]
        behind = [cost_and_errors(moved(stage, -h * e)) for e in np.eye(9)]
        slope = [(a[0] - b[0]) / (2 * h) for a, b in zip(ahead, behind, strict=True)]
        np.testing.assert_allclose(2.0 * g[stage], slope, rtol=1e-6, atol=1e-6)
        J = np.stack(
            [(a[1][stage] - b[1][stage]) / (2 * h) for a, b in zip(ahead, behind, strict=True)],
            axis=-1,
        )
        weight = SETTINGS.terminal_weight if stage == STEPS - 1 else 1.0
        expected = weight * J.T @ np.diag(SETTINGS.Q) @ J
        np.testing.assert_allclose(H[stage], expected, rtol=1e-6, atol=1e-6)

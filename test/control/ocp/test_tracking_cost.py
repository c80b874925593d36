"""The cost's gradient and Gauss-Newton matrix, by finite differences through ⊞."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.rollout import P_WB, R_WB, ROW_SIZE, V_WB_W
from quad_mpc_ros.control.ocp.target import Target
from quad_mpc_ros.control.ocp.tracking_cost import Weights, quadratic_cost, tracking_cost

STEPS = 3
RNG = np.random.default_rng(2)
WEIGHTS = Weights(
    Q=np.array([10.0, 9.0, 8.0, 1.0, 2.0, 3.0, 0.5, 0.7, 0.9]),
    R=np.array([0.1, 0.001, 0.002, 0.003]),
    terminal=30.0,
)
TARGET = Target(
    p_WB=RNG.normal(size=(STEPS, 3)),
    v_WB_W=RNG.normal(size=(STEPS, 3)),
    R_WB=so3.exp(RNG.normal(size=(STEPS, 3))),
    inputs=np.zeros((STEPS, 4, 4)),
    mean_inputs=np.zeros((STEPS, 4)),
    R_WB_start=np.eye(3),
)


def rows(p_WB: Array, v_WB_W: Array, rotations: Array) -> Array:
    states = np.zeros((STEPS + 1, ROW_SIZE))
    states[:, P_WB], states[:, V_WB_W] = p_WB, v_WB_W
    states[:, R_WB] = rotations.reshape(-1, 9)
    return states


STATES = rows(
    RNG.normal(size=(STEPS + 1, 3)),
    RNG.normal(size=(STEPS + 1, 3)),
    so3.exp(1.5 * RNG.normal(size=(STEPS + 1, 3))),
)
DEVIATION = RNG.normal(size=(STEPS, 4))


def cost_and_errors(states: Array) -> tuple[float, Array]:
    errors = np.zeros((STEPS, 9))
    return tracking_cost(WEIGHTS, states, TARGET, DEVIATION, errors), errors


def moved(stage: int, step: Array) -> Array:
    states = STATES.copy()
    row = states[stage + 1]
    row[P_WB] += step[0:3]
    row[V_WB_W] += step[3:6]
    row[R_WB] = (row[R_WB].reshape(3, 3) @ so3.exp(step[6:9])).ravel()
    return states


def test_gradient_and_gauss_newton_matrix() -> None:
    h = 1e-6
    _, errors = cost_and_errors(STATES)
    H, g = np.zeros((STEPS, 9, 9)), np.zeros((STEPS, 9))
    quadratic_cost(WEIGHTS, errors, H, g)
    for stage in range(STEPS):
        ahead = [cost_and_errors(moved(stage, h * e)) for e in np.eye(9)]
        behind = [cost_and_errors(moved(stage, -h * e)) for e in np.eye(9)]
        slope = [(a[0] - b[0]) / (2 * h) for a, b in zip(ahead, behind, strict=True)]
        np.testing.assert_allclose(2.0 * g[stage], slope, rtol=1e-6, atol=1e-6)
        J = np.stack(
            [(a[1][stage] - b[1][stage]) / (2 * h) for a, b in zip(ahead, behind, strict=True)],
            axis=-1,
        )
        weight = WEIGHTS.terminal if stage == STEPS - 1 else 1.0
        expected = weight * J.T @ np.diag(WEIGHTS.Q) @ J
        np.testing.assert_allclose(H[stage], expected, rtol=1e-6, atol=1e-6)


def test_on_the_target_only_deviations_cost() -> None:
    states = rows(
        np.vstack((np.zeros(3), TARGET.p_WB)),
        np.vstack((np.zeros(3), TARGET.v_WB_W)),
        np.concatenate((np.eye(3)[None], TARGET.R_WB)),
    )
    cost, errors = cost_and_errors(states)
    np.testing.assert_allclose(errors, 0.0, atol=1e-15)
    assert np.isclose(cost, np.sum(DEVIATION**2 @ WEIGHTS.R))

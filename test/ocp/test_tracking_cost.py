"""The cost's gradient and Gauss-Newton matrix, by finite differences through ⊞."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.rollout import Motion
from quad_mpc_ros.ocp.target import empty_target
from quad_mpc_ros.ocp.tracking_cost import Weights, quadratic_cost, tracking_cost

STEPS = 3
RNG = np.random.default_rng(2)
WEIGHTS = Weights(
    Q=np.array([10.0, 9.0, 8.0, 1.0, 2.0, 3.0, 0.5, 0.7, 0.9]),
    R=np.array([0.1, 0.001, 0.002, 0.003]),
    stage=np.array([1.0, 1.0, 30.0]),
)
TARGET = empty_target(STEPS, 4)._replace(
    p_WB=RNG.normal(size=(STEPS, 3)),
    v_WB_W=RNG.normal(size=(STEPS, 3)),
    R_WB=so3.exp(RNG.normal(size=(STEPS, 3))),
)
STATES = Motion(
    p_WB=RNG.normal(size=(STEPS + 1, 3)),
    v_WB_W=RNG.normal(size=(STEPS + 1, 3)),
    R_WB=so3.exp(1.5 * RNG.normal(size=(STEPS + 1, 3))),
    actuators=np.zeros((STEPS + 1, 4)),
)
DEVIATION = RNG.normal(size=(STEPS, 4))


def cost_and_errors(states: Motion) -> tuple[float, Array]:
    errors = np.zeros((STEPS, 9))
    return tracking_cost(WEIGHTS, states, TARGET, DEVIATION, errors), errors


def moved(stage: int, step: Array) -> Motion:
    p, v, R = STATES.p_WB.copy(), STATES.v_WB_W.copy(), STATES.R_WB.copy()
    p[stage + 1] += step[0:3]
    v[stage + 1] += step[3:6]
    R[stage + 1] = R[stage + 1] @ so3.exp(step[6:9])
    return STATES._replace(p_WB=p, v_WB_W=v, R_WB=R)


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
        expected = WEIGHTS.stage[stage] * J.T @ np.diag(WEIGHTS.Q) @ J
        np.testing.assert_allclose(H[stage], expected, rtol=1e-6, atol=1e-6)


def test_on_the_target_only_deviations_cost() -> None:
    states = Motion(
        p_WB=np.vstack((np.zeros(3), TARGET.p_WB)),
        v_WB_W=np.vstack((np.zeros(3), TARGET.v_WB_W)),
        R_WB=np.concatenate((np.eye(3)[None], TARGET.R_WB)),
        actuators=STATES.actuators,
    )
    cost, errors = cost_and_errors(states)
    np.testing.assert_allclose(errors, 0.0, atol=1e-15)
    assert np.isclose(cost, np.sum(DEVIATION**2 @ WEIGHTS.R))

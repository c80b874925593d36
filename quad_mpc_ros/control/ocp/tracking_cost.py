"""The cost of a predicted motion, and its quadratic model, in compiled loops.

    J = sum_{i=1..N} w_i |x_i ⊟ x_r,i|_Q^2 + sum_{i=0..N-1} |δ_i|_R^2,   w_N the terminal weight

with the errors of position, velocity in the world (whose norm is that in the body) and attitude at
the ends of the stages, and the inputs' deviations δ from those that hold the reference. The
Hessian is that of Gauss and Newton: the attitude error e moves by J_r^-1(e) for a turn of the
body. What breaking soft limits costs is added by :func:`quad_mpc_ros.control.ocp.limits.penalty`.
"""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import body_in
from quad_mpc_ros.control.ocp.target import Target


class Weights(NamedTuple):
    """``Q`` (9,) of position, velocity and attitude, ``R`` (4,) of throttle and rates, and the
    factor on Q at the last stage.
    """

    Q: Array
    R: Array
    terminal: float


@compiled
def tracking_cost(
    weights: Weights, states: Array, target: Target, deviation: Array, errors: Array
) -> float:
    """Return the cost of states 0 to N (N + 1, 19) and deviations (N, 4); write errors (N, 9)."""
    cost = 0.0
    for i in range(len(deviation)):
        body = body_in(states[i + 1])
        for k in range(3):
            errors[i, k] = body.p[k] - target.p_WB[i, k]
            errors[i, 3 + k] = body.v[k] - target.v_WB_W[i, k]
        R_target = kernels.matrix(target.R_WB[i])
        R_error = kernels.multiply(kernels.transposed(R_target), body.R)
        kernels.store_vector(kernels.log(R_error), errors[i, 6:])
        factor = _stage_weight(weights, i, len(deviation))
        for k in range(9):
            cost += factor * weights.Q[k] * errors[i, k] ** 2
        for k in range(4):
            cost += weights.R[k] * deviation[i, k] ** 2
    return cost


@compiled
def quadratic_cost(weights: Weights, errors: Array, H: Array, g: Array) -> None:
    """Write half the Hessian (N, nx, nx) and half the gradient (N, nx) at errors (N, 9)."""
    Q = weights.Q
    for i in range(len(errors)):
        factor = _stage_weight(weights, i, len(errors))
        for k in range(6):
            H[i, k, k] = factor * Q[k]
            g[i, k] = factor * Q[k] * errors[i, k]
        e = kernels.vector(errors[i, 6:])
        J = kernels.right_jacobian_inverse(e)
        weighted = factor * Q[6] * e[0], factor * Q[7] * e[1], factor * Q[8] * e[2]
        kernels.store_vector(kernels.apply_transposed(J, weighted), g[i, 6:9])
        for a in range(3):
            for b in range(3):
                H[i, 6 + a, 6 + b] = factor * (
                    J[a] * Q[6] * J[b] + J[3 + a] * Q[7] * J[3 + b] + J[6 + a] * Q[8] * J[6 + b]
                )


@compiled
def _stage_weight(weights: Weights, stage: int, steps: int) -> float:
    return weights.terminal if stage == steps - 1 else 1.0

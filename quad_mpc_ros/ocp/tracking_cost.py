"""The cost of a predicted motion, and its quadratic model, in compiled loops.

Errors x ⊟ x_r of position, velocity in the world (whose norm is that in the body) and attitude,
weighted by Q at the ends of the stages, and the inputs' deviations from those that hold the
reference, weighted by R. The Hessian is that of Gauss and Newton: the attitude error e moves by
J_r^-1(e) for a turn of the body.
"""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.rollout import Motion
from quad_mpc_ros.ocp.target import Target


class Weights(NamedTuple):
    """``Q`` (9,) of position, velocity and attitude, ``R`` (4,) of throttle and rates, ``stage``
    (N,) factors on Q.
    """

    Q: Array
    R: Array
    stage: Array


@compiled
def tracking_cost(
    weights: Weights, states: Motion, target: Target, deviation: Array, errors: Array
) -> float:
    """Return the cost of states 0 to N and deviations (N, 4), and write the errors (N, 9)."""
    cost = 0.0
    for i in range(len(deviation)):
        for k in range(3):
            errors[i, k] = states.p_WB[i + 1, k] - target.p_WB[i, k]
            errors[i, 3 + k] = states.v_WB_W[i + 1, k] - target.v_WB_W[i, k]
        R_target = kernels.matrix(target.R_WB[i])
        R_error = kernels.multiply(
            kernels.transposed(R_target), kernels.matrix(states.R_WB[i + 1])
        )
        kernels.store_vector(kernels.log(R_error), errors[i, 6:])
        for k in range(9):
            cost += weights.stage[i] * weights.Q[k] * errors[i, k] ** 2
        for k in range(4):
            cost += weights.R[k] * deviation[i, k] ** 2
    return cost


@compiled
def quadratic_cost(weights: Weights, errors: Array, H: Array, g: Array) -> None:
    """Write half the Hessian (N, nx, nx) and half the gradient (N, nx) at errors (N, 9)."""
    Q = weights.Q
    for i in range(len(errors)):
        factor = weights.stage[i]
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

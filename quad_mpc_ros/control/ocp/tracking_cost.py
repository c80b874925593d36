"""The cost of a predicted motion, and its quadratic model, in compiled loops.

    J = sum_{i=1..N} w_i |x_i ⊟ x_r,i|_Q^2 + sum_{i=0..N-1} |δ_i|_R^2,   w_N the terminal weight

with the errors of position, velocity in the world (whose norm is that in the body) and attitude at
the ends of the stages, and the inputs' deviations δ from those that hold the reference. The
Hessian is that of Gauss and Newton: the attitude error e moves by J_r^-1(e) for a turn of the
body. What breaking soft limits costs is added by :func:`quad_mpc_ros.control.ocp.limits.penalty`.
"""

from __future__ import annotations

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import StateRecord, body_in
from quad_mpc_ros.control.model.state import INPUT_SIZE, TANGENT_SIZE, THETA, P, V
from quad_mpc_ros.control.ocp.settings import Settings
from quad_mpc_ros.control.ocp.target import TargetStage


@compiled
def tracking_cost(
    given: Settings,
    states: RecordArray[StateRecord],
    target: RecordArray[TargetStage],
    deviation: Array,
    errors: Array,
) -> float:
    """Return the cost of states 0 to N (N + 1,) and deviations (N, 4); write errors (N, 9)."""
    cost = 0.0
    for i in range(len(deviation)):
        body, stage, error = body_in(states[i + 1]), target[i], errors[i]
        for k in range(3):
            error[P + k] = body.p[k] - stage.p_WB[k]
            error[V + k] = body.v[k] - stage.v_WB_W[k]
        R_error = kernels.multiply(kernels.transposed(kernels.matrix(stage.R_WB)), body.R)
        kernels.store_vector(kernels.log(R_error), error[THETA:])
        factor = _stage_weight(given, i, len(deviation))
        for k in range(TANGENT_SIZE):
            cost += factor * given.Q[k] * error[k] ** 2
        for k in range(INPUT_SIZE):
            cost += given.R[k] * deviation[i, k] ** 2
    return cost


@compiled
def quadratic_cost(given: Settings, errors: Array, H: Array, g: Array) -> None:
    """Write half the Hessian (N, nx, nx) and half the gradient (N, nx) at errors (N, 9)."""
    Q = given.Q
    for i in range(len(errors)):
        factor = _stage_weight(given, i, len(errors))
        for k in range(THETA):
            H[i, k, k] = factor * Q[k]
            g[i, k] = factor * Q[k] * errors[i, k]
        e, q = kernels.vector(errors[i, THETA:]), kernels.vector(Q[THETA:])
        J = kernels.right_jacobian_inverse(e)
        weighted = factor * q[0] * e[0], factor * q[1] * e[1], factor * q[2] * e[2]
        kernels.store_vector(kernels.apply_transposed(J, weighted), g[i, THETA:])
        for a in range(3):
            by_a = kernels.column(J, a)
            for b in range(3):
                by_b = kernels.column(J, b)
                H[i, THETA + a, THETA + b] = factor * (
                    by_a[0] * q[0] * by_b[0] + by_a[1] * q[1] * by_b[1] + by_a[2] * q[2] * by_b[2]
                )


@compiled
def _stage_weight(given: Settings, stage: int, steps: int) -> float:
    return given.terminal_weight if stage == steps - 1 else 1.0

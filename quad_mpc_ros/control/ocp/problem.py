# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The optimal control problem on SO(3), and its QP about a plan::

    minimise    sum_{i=1..N}   w_i |e_i|_Q^2 + sum_{i=0..N-1} |δ_i|_R^2,    e_i = x_i ⊟ x_r,i
                + penalty of the soft limits + cost of progress along the reference
    subject to  x_{i+1} = f(x_i, u_r,i + δ_i),   u_min <= mean(u_r,i) + δ_i <= u_max,   x_0 given

in the deviations δ, one per stage, from the inputs u_r that hold the reference
(:mod:`quad_mpc_ros.control.model.target`). The errors e are of position, velocity in the world
(equal in norm to the body velocity) and attitude at the ends of the stages; w_N is the terminal
weight, other w_i are 1.

About a plan, which is rolled out from the current state and so has no defects, the QP is::

    minimise    sum_{i=1..N}   1/2 dx_i' H_i dx_i + g_i' dx_i
              + sum_{i=0..N-1} 1/2 du_i' R du_i + r_i' du_i + c' s_i + 1/2 s_i' D s_i
    subject to  dx_{i+1} = A_i dx_i + B_i du_i,   dx_0 = 0
                u_min <= mean(u_r,i) + δ_i + du_i <= u_max
                n_ij' dx_{i+1} - s_i,k(j) <= b_ij,   s_i >= 0
    with        H_i = w_i J_i' Q J_i,   g_i = w_i J_i' Q e_i,   r_i = R δ_i

where A_i and B_i are the exact Jacobians of :mod:`quad_mpc_ros.control.model.jacobians`, and the
last row is the soft limits (c and D are ``linear`` and ``quadratic`` of the stages). The cost is
half of the true cost to second order, except for the curvature of e (Gauss-Newton): J is the
identity for position and velocity, and J_r^-1(e) for the attitude error, its derivative with
respect to a body rotation. :func:`write_qp` writes the QP: dynamics, the cost of states, the cost
and the bounds of inputs, then the parts of limits and progress.

Soft limits, including half-spaces, and progress share an interface. :mod:`.limits` and
:mod:`.progress` mark their entries in the pattern, and have three functions: ``write_...`` adds
numbers to a :class:`HorizonStages`, ``..._cost`` is its part of the true cost, and
``regularise_...`` adds a cost to changes of the plan near a limit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.jacobians import (
    ACCELERATION,
    RATE,
    STATE_SIZE,
    THROTTLE,
    WITHOUT_ACCELERATION,
    WITHOUT_ACTUATORS,
    jacobians,
)
from quad_mpc_ros.control.model.prediction import Prediction
from quad_mpc_ros.control.model.reference_window import SampleRecord
from quad_mpc_ros.control.model.rollout import StateRecord, body_in
from quad_mpc_ros.control.model.state import (
    ATTITUDE,
    BODY_RATE,
    INPUT_SIZE,
    POSITION,
    TANGENT_SIZE,
    THETA,
    U_THROTTLE,
    VELOCITY,
    P,
    V,
)
from quad_mpc_ros.control.model.target import TargetStage
from quad_mpc_ros.control.ocp import progress
from quad_mpc_ros.control.ocp.horizon_qp import HorizonPattern, HorizonStages
from quad_mpc_ros.control.ocp.limits import Limits, limits_cost, regularise_limits, write_limits
from quad_mpc_ros.control.ocp.plan import PlannedTrajectory, mark_free
from quad_mpc_ros.control.ocp.progress import (
    ProgressBuffers,
    progress_cost,
    regularise_progress,
    write_progress,
)
from quad_mpc_ros.control.ocp.settings import ProblemSettings, stage_weight

_ACCELERATION_SIZE = 50.0  # rad/s^2
_STATE_SIZES = np.concatenate(
    (np.repeat([1.0, 3.0, 0.5, 5.0], 3), [0.3], np.repeat(_ACCELERATION_SIZE, 3))
)
_INPUT_SIZES = np.array([0.3, 5.0, 5.0, 5.0])


class OcpArrays(NamedTuple):
    """The arrays of N stages.

    ``target`` (N,) is the reference along the horizon, ``nominal`` the plan linearised along,
    ``plan`` the last plan, ``stages`` the QP and ``R`` (4,) the weights of the inputs of this
    step. ``progress`` is empty if the reference is tracked in time.
    """

    target: RecordArray[TargetStage]
    nominal: PlannedTrajectory
    plan: PlannedTrajectory
    progress: ProgressBuffers
    limits: Limits
    stages: HorizonStages
    R: Array


class Problem(NamedTuple):
    """A problem: the reference, starting ``elapsed_ns`` after its stamp, prediction and settings.

    ``samples`` (n,) are the reference window's. ``prediction`` and ``settings`` are single
    records.
    """

    elapsed_ns: int
    samples: RecordArray[SampleRecord]
    prediction: RecordArray[Prediction]
    settings: RecordArray[ProblemSettings]
    work: OcpArrays


def pattern_of(config: MpcConfig, limits: Limits) -> HorizonPattern:
    """Return the sparsity of the QP, and the natural sizes of its variables."""
    lags, nx, nu = config.lags, WITHOUT_ACTUATORS, INPUT_SIZE
    # Without lags rate and throttle are their commands and need no states of their own.
    if max(*per_axis(lags.rate), lags.thrust) > 0.0:
        has_acceleration = max(per_axis(lags.torque)) > 0.0
        nx = STATE_SIZE if has_acceleration else WITHOUT_ACCELERATION
    diagonal, all_states = np.eye(3, dtype=bool), progress.SIZE
    A = np.zeros((all_states, all_states), dtype=bool)
    A[POSITION, POSITION] = A[POSITION, VELOCITY] = A[VELOCITY, VELOCITY] = diagonal
    A[:THETA, THETA:STATE_SIZE] = True
    A[ATTITUDE, THETA:THROTTLE] = A[ATTITUDE, ACCELERATION] = True
    A[RATE, RATE] = A[RATE, ACCELERATION] = diagonal
    A[ACCELERATION, RATE] = A[ACCELERATION, ACCELERATION] = diagonal
    A[THROTTLE, THROTTLE] = True
    B = np.zeros((all_states, progress.INPUTS), dtype=bool)
    B[:THETA, :INPUT_SIZE] = True
    B[ATTITUDE, BODY_RATE] = True
    B[RATE, BODY_RATE] = B[ACCELERATION, BODY_RATE] = diagonal
    B[THROTTLE, U_THROTTLE] = True
    H = np.zeros((all_states, all_states), dtype=bool)
    H[:THETA, :THETA] = np.eye(THETA, dtype=bool)
    H[ATTITUDE, ATTITUDE] = True
    if config.formulation == "contouring":
        nx, nu = progress.SIZE, progress.INPUTS
        progress.mark_progress(A, B, H)
    return HorizonPattern(
        steps=config.horizon_steps,
        A=A[:nx, :nx],
        B=B[:nx, :nu],
        H=H[:nx, :nx],
        state_size=np.append(_STATE_SIZES, progress.STATE_SIZES)[:nx],
        input_size=np.append(_INPUT_SIZES, progress.INPUT_SIZES)[:nu],
        limits=limits.pattern(nx),
    )


@compiled
def write_qp(problem: Problem, is_flipping: bool) -> float:
    """Roll out the nominal plan, write the QP about this plan, and return its true cost.

    While the reference ``is_flipping``, steep gradients alone add no cost to changes of the plan.
    """
    settings, work, stages = problem.settings[()], problem.work, problem.work.stages
    target, plan, errors = work.target, work.nominal, np.empty((len(work.target), TANGENT_SIZE))
    has_progress = len(work.progress.nominal) > 0
    _write_dynamics(problem)
    cost = tracking_cost(settings, work.R, plan.states, target, plan.deviation, errors)
    write_tracking_cost(settings, errors, stages.H, stages.g)
    _write_inputs(settings, work.R, target, plan, stages)
    if has_progress:
        write_progress(settings, errors, work.progress, stages)
        cost += progress_cost(settings, work.progress.nominal)
    if len(work.limits.bounds) > 0:
        penalty, activity = write_limits(work.limits, plan.states, stages)
        cost += penalty
        full_damping_slope = math.inf if is_flipping else settings.full_damping_slope
        scale = regularise_limits(
            work.R, work.limits.weights, activity, full_damping_slope, stages
        )
        if has_progress:
            regularise_progress(settings.progress_weight, scale, stages)
    return cost


@compiled
def _write_dynamics(problem: Problem) -> None:
    """Write A_i and B_i, and the states x_i of the nominal plan."""
    plan, stages, prediction = problem.work.nominal, problem.work.stages, problem.prediction[()]
    free = np.empty_like(plan.inputs)
    mark_free(problem.work.target, plan, free)
    jacobians(
        prediction.parameters,
        problem.settings[()].step,
        inputs=plan.inputs,
        free=free,
        start=prediction.state,
        states=plan.states,
        A=stages.A,
        B=stages.B,
    )


@compiled
def tracking_cost(
    settings: ProblemSettings,
    R: Array,
    states: RecordArray[StateRecord],
    target: RecordArray[TargetStage],
    deviation: Array,
    errors: Array,
) -> float:
    """Return the cost of states 0 to N (N + 1,) and deviations δ (N, 4); write errors e (N, 9)."""
    cost = 0.0
    for i in range(len(deviation)):
        body, stage, error = body_in(states[i + 1]), target[i], errors[i]
        for k in range(3):
            error[P + k] = body.p[k] - stage.p_WB[k]
            error[V + k] = body.v[k] - stage.v_WB_W[k]
        R_error = kernels.multiply(kernels.transposed(kernels.matrix(stage.R_WB)), body.R)
        kernels.store_vector(kernels.log(R_error), error[THETA:])
        weight = stage_weight(settings, i, len(deviation))
        for k in range(TANGENT_SIZE):
            cost += weight * settings.Q[k] * error[k] ** 2
        for k in range(INPUT_SIZE):
            cost += R[k] * deviation[i, k] ** 2
    return cost


@compiled
def write_tracking_cost(settings: ProblemSettings, errors: Array, H: Array, g: Array) -> None:
    """Write H_i (N, nx, nx) and g_i (N, nx) at errors e (N, 9)."""
    Q = settings.Q
    for i in range(len(errors)):
        w = stage_weight(settings, i, len(errors))
        for k in range(THETA):
            H[i, k, k] = w * Q[k]
            g[i, k] = w * Q[k] * errors[i, k]
        e, q = kernels.vector(errors[i, THETA:]), kernels.vector(Q[THETA:])
        J = kernels.right_jacobian_inverse(e)
        weighted = w * q[0] * e[0], w * q[1] * e[1], w * q[2] * e[2]
        kernels.store_vector(kernels.apply_transposed(J, weighted), g[i, THETA:])
        for a in range(3):
            by_a = kernels.column(J, a)
            for b in range(3):
                by_b = kernels.column(J, b)
                H[i, THETA + a, THETA + b] = w * (
                    by_a[0] * q[0] * by_b[0] + by_a[1] * q[1] * by_b[1] + by_a[2] * q[2] * by_b[2]
                )


@compiled
def _write_inputs(
    settings: ProblemSettings,
    R: Array,
    target: RecordArray[TargetStage],
    plan: PlannedTrajectory,
    stages: HorizonStages,
) -> None:
    """Write R, r_i = R δ_i and the bounds of du_i."""
    for i in range(len(target)):
        for k in range(INPUT_SIZE):
            u = target[i].mean_input[k] + plan.deviation[i, k]
            stages.R[i, k] = R[k]
            stages.r[i, k] = R[k] * plan.deviation[i, k]
            # So that du = 0 is feasible.
            stages.lower[i, k] = min(settings.u_min[k] - u, 0.0)
            stages.upper[i, k] = max(settings.u_max[k] - u, 0.0)


@compiled
def plan_cost(problem: Problem) -> float:
    """Return the true cost of the last plan, whose states and target are rolled out."""
    settings, work = problem.settings[()], problem.work
    plan, errors = work.plan, np.empty((len(work.target), TANGENT_SIZE))
    cost = tracking_cost(settings, work.R, plan.states, work.target, plan.deviation, errors)
    cost += progress_cost(settings, work.progress.plan)
    if len(work.limits.bounds) > 0:
        penalty, _activity = limits_cost(work.limits, plan.states)
        cost += penalty
    return cost

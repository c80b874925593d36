"""The SQP of the manifold formulation, compiled: warm start, linearise, line search.

:mod:`.manifold` has the equations. What one call leaves to the next is in one
buffer, the workspace. So a tick crosses from Python into compiled code twice, before the solver
and after it: a call that finds the caches cold costs as much as a fifth of the linearisation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.jacobians import jacobians
from quad_mpc_ros.control.model.parameters import parameters_in, rate_offset_at
from quad_mpc_ros.control.model.rollout import body_in, roll_out
from quad_mpc_ros.control.model.state import INPUT_SIZE
from quad_mpc_ros.control.ocp.limits import (
    ALLOWED_SIZE,
    allow,
    damp,
    draw_near,
    flips,
    let_tilt,
    penalty,
    values_of,
    write_limits,
)
from quad_mpc_ros.control.ocp.problem import PredictionParts, prediction_in
from quad_mpc_ros.control.ocp.stages import Shape, stages_in
from quad_mpc_ros.control.ocp.target import sample_target, target_in, target_size
from quad_mpc_ros.control.ocp.tracking_cost import Weights, quadratic_cost, tracking_cost
from quad_mpc_ros.control.ocp.trajectory import (
    apply_bounds,
    mark_free,
    shift,
    trajectory_in,
    trajectory_size,
)

_COLD_ITERATIONS = 5
_JUMP_ITERATIONS = 3
# A shifted plan whose cost has grown by this much meets a reference that has jumped.
_JUMP_FACTOR, _JUMP_FLOOR = 4.0, 0.1
_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)


class Settings(NamedTuple):
    """What is configured of the problem: the parts of one vector, see :func:`settings_in`.

    ``step`` [s] of a stage; ``u_min`` and ``u_max`` (4,) bound throttle and rates, ``rate_gain``
    (3,) is theirs over their commands. ``limits`` (4,) are soft ones by kind; a reference further
    away than ``distance`` [m] pulls as if it were that near, and a slope of the cost is steep at
    ``steep``.
    """

    weights: Weights
    step: float
    u_min: Array
    u_max: Array
    rate_gain: Array
    limits: Array
    distance: float
    steep: float


def settings_of(config: MpcConfig) -> Array:
    """Return the vector (32,) of a configuration."""
    gain = np.array(per_axis(config.rate_gain))
    # Inputs of the problem are what the rates follow, commands times their gain.
    fastest = gain * config.omega_max
    u_min = config.throttle_min, *(-fastest)
    u_max = config.throttle_max, *fastest
    weights = *config.Q, *config.R, config.terminal_weight
    # A slew of commands is one of what the rates follow, of the axis that follows least.
    followed = np.array([1.0, 1.0, 1.0, min(gain)])
    limits = followed * values_of(config.limits)
    # The slope of the cost where the position is off by the distance at which the pull stays
    # the same, per 3 m/s.
    distance = config.limits.pull_distance
    duration = config.horizon_steps * config.horizon_step
    heaviest = max(config.terminal_weight, 1.0) * max(*config.Q[:3], 1e-9)
    steep = 3.0 * duration * heaviest * distance
    return np.array(
        [*weights, config.horizon_step, *u_min, *u_max, *gain, *limits, distance, steep]
    )


@compiled
def settings_in(vector: Array) -> Settings:
    """Return what is in the vector (32,)."""
    return Settings(
        Weights(vector[0:9], vector[9:13], vector[13]),
        vector[14],
        vector[15:19],
        vector[19:23],
        vector[23:26],
        vector[26:30],
        vector[30],
        vector[31],
    )


class Workspace(NamedTuple):
    """What is kept of N stages: the parts of one buffer, see :func:`workspace_in`.

    ``target`` is the reference along the horizon (:func:`.target.target_in`), ``nominal`` the plan
    linearised along and ``plan`` the last one (:func:`.trajectory.trajectory_in`). Where there are
    soft limits ``allowed`` (N, 10) is what they allow along the target, else (0, 10), and
    ``prices`` (4,) are those of the present iterate.
    """

    target: Array
    nominal: Array
    plan: Array
    allowed: Array
    prices: Array


def workspace_for(steps: int, *, is_limited: bool) -> Array:
    """Return the buffer of N stages, zeros."""
    allowed = steps * ALLOWED_SIZE if is_limited else 0
    return np.zeros(target_size(steps) + 2 * trajectory_size(steps) + allowed + 4)


@compiled
def workspace_in(layout: Shape, buffer: Array) -> Workspace:
    """Return the parts of a buffer, in which they are one after another.

    The ``layout`` (13,) is the shape of the stages and the first row and slack of each limit.
    """
    n = layout[0]
    nominal = target_size(n)
    plan = nominal + trajectory_size(n)
    allowed = plan + trajectory_size(n)
    return Workspace(
        buffer[:nominal],
        buffer[nominal:plan],
        buffer[plan:allowed],
        buffer[allowed:-4].reshape((-1, ALLOWED_SIZE)),
        buffer[-4:],
    )


class Problem(NamedTuple):
    """All that an iteration works on: prediction, settings, workspace, and where the QP goes."""

    state: PredictionParts
    given: Settings
    work: Workspace
    layout: Shape
    stages: Array


@compiled
def problem_in(
    prediction: Array, settings: Array, layout: Shape, workspace: Array, stages: Array
) -> Problem:
    """Return the parts of buffers."""
    return Problem(
        prediction_in(prediction),
        settings_in(settings),
        workspace_in(layout, workspace),
        layout,
        stages,
    )


@compiled
def begin(
    elapsed_ns: int,
    offsets_ns: NDArray[np.int64],
    samples: Array,
    prediction: Array,
    last: tuple[float, float],
    recovering: bool,
    settings: Array,
    layout: Shape,
    workspace: Array,
    stages: Array,
) -> tuple[float, int, bool]:
    """Write target and limits, and the QP about the best start there is.

    Args:
        elapsed_ns: From the stamp of a reference window to the prediction's.
        offsets_ns: Of the window's samples (n,), from its stamp on.
        samples: Those, see :func:`quad_mpc_ros.control.model.reference_window.packed`.
        prediction: See :func:`quad_mpc_ros.control.ocp.problem.prediction_in`.
        last: For how many stages the last plan has been flown, and its cost, NaN without one.
        recovering: Whether the reference flipped a moment ago.
        settings: See :func:`settings_in`.
        layout: See :func:`workspace_in`.
        workspace: The target, what limits allow and the nominal plan are written.
        stages: The QP, see :func:`quad_mpc_ros.control.ocp.stages.stages_in`.

    Returns:
        The cost of the start, the iterations that it needs, and whether the reference flips.
    """
    problem = problem_in(prediction, settings, layout, workspace, stages)
    given, work = problem.given, problem.work
    sample_target(
        elapsed_ns,
        offsets_ns,
        samples,
        problem.state.parameters,
        given.step,
        u_min=given.u_min,
        u_max=given.u_max,
        buffer=work.target,
    )
    is_flipping = len(work.allowed) > 0 and _write_allowed(problem)
    if recovering or is_flipping:
        let_tilt(work.allowed)
    cost, iterations, closeness = _warm_start(last, problem)
    _damp(closeness, recovering or is_flipping, problem)
    return cost, iterations, is_flipping


@compiled
def _write_allowed(problem: Problem) -> bool:
    """Draw the target near, and write what limits allow along it; return whether it flips."""
    given, state, work = problem.given, problem.state, problem.work
    draw_near(given.step, state.row, given.distance, work.target)
    allow(
        given.limits,
        given.step,
        u_min=given.u_min,
        u_max=given.u_max,
        sent=state.sent,
        since=state.since_sent,
        target=work.target,
        allowed=work.allowed,
    )
    return flips(given.step, given.u_max, work.target)


@compiled
def _warm_start(last: tuple[float, float], problem: Problem) -> tuple[float, int, float]:
    """Linearise along the best start; return its cost, the iterations, and the closeness."""
    elapsed, last_cost = last
    planned = trajectory_in(problem.work.plan).deviation
    if math.isnan(last_cost):
        cost, closeness = _linearise_along(np.zeros_like(planned), 0.0, problem)
        return cost, _COLD_ITERATIONS, closeness
    shifted, closeness = _linearise_along(planned, elapsed, problem)
    if shifted <= _JUMP_FACTOR * last_cost + _JUMP_FLOOR:
        return shifted, 1, closeness
    cost, closeness = _linearise_along(np.zeros_like(planned), 0.0, problem)
    if not cost < shifted:
        cost, closeness = _linearise_along(planned, elapsed, problem)
    return cost, _JUMP_ITERATIONS, closeness


@compiled
def relinearise(
    prediction: Array,
    is_flipping: bool,
    settings: Array,
    layout: Shape,
    workspace: Array,
    stages: Array,
) -> float:
    """Write the QP about the last plan, for another iteration; return the plan's cost."""
    problem = problem_in(prediction, settings, layout, workspace, stages)
    planned = trajectory_in(problem.work.plan).deviation
    cost, closeness = _linearise_along(planned, 0.0, problem)
    _damp(closeness, is_flipping, problem)
    return cost


@compiled
def _damp(closeness: float, is_flipping: bool, problem: Problem) -> None:
    """Let changes of the plan cost something, where there are limits."""
    given, work = problem.given, problem.work
    if len(work.allowed) > 0:
        damp(
            given.weights.R,
            prices=work.prices,
            closeness=closeness,
            steep=math.inf if is_flipping else given.steep,
            shape=problem.layout,
            stages=problem.stages,
        )


@compiled
def _linearise_along(deviation: Array, elapsed: float, problem: Problem) -> tuple[float, float]:
    """Write the QP about a plan shifted by ``elapsed`` stages; return its cost and closeness.

    That is how close it comes to a limit.
    """
    cost, work = _linearise(deviation, elapsed, problem), problem.work
    if len(work.allowed) == 0:
        return cost, 0.0
    paid, closeness = write_limits(
        problem.layout[5:].reshape((4, 2)),
        target=work.target,
        nominal=work.nominal,
        allowed=work.allowed,
        prices=work.prices,
        shape=problem.layout,
        stages=problem.stages,
    )
    return cost + paid, closeness


@compiled
def _linearise(deviation: Array, elapsed: float, problem: Problem) -> float:
    """Write tracking cost and dynamics of the QP; return the cost."""
    weights, u_min, u_max = problem.given.weights, problem.given.u_min, problem.given.u_max
    tracked, plan = target_in(problem.work.target), trajectory_in(problem.work.nominal)
    written = stages_in(problem.layout, problem.stages)
    dynamics, state_cost, input_terms = written.dynamics, written.state_cost, written.input_terms
    nx = dynamics.shape[1]
    free, errors = np.empty_like(plan.inputs), np.empty((len(dynamics), 9))
    shift(deviation, elapsed, plan.deviation)
    apply_bounds(tracked, plan, u_min=u_min, u_max=u_max)
    mark_free(tracked, plan, free)
    jacobians(
        parameters_in(problem.state.parameters),
        problem.given.step,
        inputs=plan.inputs,
        free=free,
        start=problem.state.row,
        states=plan.states,
        A=dynamics[:, :, :nx],
        B=dynamics[:, :, nx:-1],
    )
    cost = tracking_cost(weights, plan.states, tracked, plan.deviation, errors)
    quadratic_cost(weights, errors, state_cost[:, :, :nx], state_cost[:, :, nx])
    for i in range(len(input_terms)):
        for k in range(INPUT_SIZE):
            planned = tracked.mean_inputs[i, k] + plan.deviation[i, k]
            input_terms[i, 0, k] = weights.R[k]
            input_terms[i, 1, k] = weights.R[k] * plan.deviation[i, k]
            # Nothing changes is always allowed.
            input_terms[i, 2, k] = min(u_min[k] - planned, 0.0)
            input_terms[i, 3, k] = max(u_max[k] - planned, 0.0)
    return cost


@compiled
def line_search(
    prediction: Array,
    change: Array,
    cost: float,
    settings: Array,
    layout: Shape,
    workspace: Array,
    inputs: Array,
    p_WB: Array,
    R_WB: Array,
) -> float:
    """Write the plan after the longest step along a ``change`` (N, 4) that lowers a cost.

    Where none does, that is the nominal plan. ``inputs`` (N M, 4) are its commands, ``p_WB``
    (N + 1, 3) and ``R_WB`` (N + 1, 3, 3) where it leads. Returns the cost reached.
    """
    given, state = settings_in(settings), prediction_in(prediction)
    work = workspace_in(layout, workspace)
    reached = _search(change, cost, state, given, work)
    _copy_plan(work.plan, given.rate_gain, state.parameters, inputs, p_WB=p_WB, R_WB=R_WB)
    return reached


@compiled
def _search(
    change: Array, cost: float, state: PredictionParts, given: Settings, work: Workspace
) -> float:
    model, tracked = parameters_in(state.parameters), target_in(work.target)
    before, tried = trajectory_in(work.nominal), trajectory_in(work.plan)
    errors, inputs = np.empty((len(change), 9)), np.empty_like(change)
    for length in _STEP_LENGTHS:
        for i in range(len(change)):
            for k in range(INPUT_SIZE):
                tried.deviation[i, k] = before.deviation[i, k] + length * change[i, k]
        apply_bounds(tracked, tried, u_min=given.u_min, u_max=given.u_max)
        roll_out(model, given.step, inputs=tried.inputs, start=state.row, states=tried.states)
        reached = tracking_cost(given.weights, tried.states, tracked, tried.deviation, errors)
        if len(work.allowed) > 0:
            inputs[:] = tracked.mean_inputs + tried.deviation
            reached += penalty(tried.states, inputs, work.allowed, work.prices)
        if reached < cost:
            return reached
    work.plan[:] = work.nominal
    return cost


@compiled
def _copy_plan(
    plan: Array, rate_gain: Array, parameters: Array, inputs: Array, p_WB: Array, R_WB: Array
) -> None:
    """Write the inputs (N M, 4) of a plan as commands, and its poses 0 to N.

    Inputs are what the rates follow: offset and gain are taken off.
    """
    planned = trajectory_in(plan)
    commands = planned.inputs.reshape((len(inputs), INPUT_SIZE))
    for i in range(len(inputs)):
        inputs[i, 0] = commands[i, 0]
        offset = rate_offset_at(parameters, commands[i, 0])
        for k in range(3):
            inputs[i, 1 + k] = (commands[i, 1 + k] - offset[k]) / rate_gain[k]
    for i in range(len(p_WB)):
        body = body_in(planned.states[i])
        kernels.store_vector(body.p, p_WB[i])
        kernels.store_matrix(body.R, R_WB[i])

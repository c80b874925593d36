"""The SQP of the manifold formulation, compiled: warm start, linearise, line search.

:mod:`.manifold` has the equations. What one call leaves to the next is in the workspace. So a tick
crosses from Python into compiled code twice, before the solver and after it: a call that finds the
caches cold costs as much as a fifth of the linearisation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.jacobians import jacobians
from quad_mpc_ros.control.model.parameters import ModelParameters, rate_offset_at
from quad_mpc_ros.control.model.reference_window import SampleRecord
from quad_mpc_ros.control.model.rollout import body_in, roll_out
from quad_mpc_ros.control.model.state import INPUT_SIZE, TANGENT_SIZE, U_RATE, U_THROTTLE
from quad_mpc_ros.control.ocp.half_spaces import HalfSpaces
from quad_mpc_ros.control.ocp.limits import (
    Allowed,
    LimitLayout,
    LimitPlace,
    allow,
    allow_any_tilt,
    flips,
    penalty,
    pull_target_closer,
    regularise,
    write_limits,
)
from quad_mpc_ros.control.ocp.problem import Prediction
from quad_mpc_ros.control.ocp.progress import (
    SPEED_INPUT,
    Progress,
    follow_path,
    progress_cost,
    regularise_progress,
    shift_speeds,
    write_progress,
)
from quad_mpc_ros.control.ocp.settings import Settings
from quad_mpc_ros.control.ocp.stages import HorizonStages
from quad_mpc_ros.control.ocp.target import TargetStage, sample_target
from quad_mpc_ros.control.ocp.tracking_cost import quadratic_cost, tracking_cost
from quad_mpc_ros.control.ocp.trajectory import (
    PlannedTrajectory,
    apply_bounds,
    copy,
    mark_free,
    shift,
)

_COLD_ITERATIONS = 5
_JUMP_ITERATIONS = 3
# A shifted plan whose cost has grown by this much meets a reference that has jumped.
_JUMP_FACTOR, _JUMP_FLOOR = 4.0, 0.1
_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)


class Workspace(NamedTuple):
    """What is kept of N stages.

    ``target`` (N,) is the reference along the horizon, ``nominal`` the plan linearised along and
    ``plan`` the last one. Where there are soft limits ``allowed`` (N,) is what they allow along
    the target, else (0,); ``prices`` (4,) are those of the present iterate, ``places`` (4,) where
    the limits stand in the stages, ``half_spaces`` the region that is free. ``progress`` is empty
    where the reference is followed by the clock.
    """

    target: RecordArray[TargetStage]
    nominal: PlannedTrajectory
    plan: PlannedTrajectory
    allowed: RecordArray[Allowed]
    prices: Array
    places: RecordArray[LimitPlace]
    half_spaces: HalfSpaces
    progress: Progress

    @staticmethod
    def zeros(steps: int, limits: LimitLayout, *, progress: bool = False) -> Workspace:
        """Return room for N stages, with ``progress`` as a variable or without."""
        return Workspace(
            target=TargetStage.zeros(steps),
            nominal=PlannedTrajectory.zeros(steps),
            plan=PlannedTrajectory.zeros(steps),
            allowed=Allowed.zeros(steps if limits.rows > 0 else 0),
            prices=np.zeros(len(limits.places)),
            places=limits.places,
            half_spaces=limits.half_spaces(steps),
            progress=Progress.zeros(steps if progress else 0),
        )

    def within(self, limits: LimitLayout) -> Workspace:
        """Return one with the same target and plans, and the limits of another layout."""
        own = Workspace.zeros(len(self.target), limits)
        shared = {name: getattr(self, name) for name in ("target", "nominal", "plan", "progress")}
        return own._replace(**shared)


class Problem(NamedTuple):
    """All that an iteration works on: the reference from a time after its stamp on, prediction,
    settings, workspace, and where the QP goes.
    """

    elapsed_ns: int
    samples: RecordArray[SampleRecord]
    state: Prediction
    given: Settings
    work: Workspace
    stages: HorizonStages


@compiled
def begin(
    elapsed_ns: int,
    samples: RecordArray[SampleRecord],
    prediction: RecordArray[Prediction],
    last: tuple[float, float],
    recovering: bool,
    settings: RecordArray[Settings],
    workspace: Workspace,
    stages: HorizonStages,
) -> tuple[float, int, bool]:
    """Write target and limits, and the QP about the best start there is.

    Args:
        elapsed_ns: From the stamp of a reference window to the prediction's.
        samples: Those of the window (n,).
        prediction: The state in which the command acts.
        last: For how many stages the last plan has been flown, and its cost, NaN without one.
        recovering: Whether the reference flipped a moment ago.
        settings: What is configured.
        workspace: The target, what limits allow and the nominal plan are written.
        stages: The QP, which is written.

    Returns:
        The cost of the start, the iterations that it needs, and whether the reference flips.
    """
    problem = Problem(elapsed_ns, samples, prediction[()], settings[()], workspace, stages)
    given, work = problem.given, problem.work
    speeds = work.progress.nominal
    if len(speeds) > 0:
        shift_speeds(work.progress.plan, last[0], speeds)
    R_start = sample_target(
        elapsed_ns,
        samples,
        problem.state.parameters,
        given.step,
        u_min=given.u_min,
        u_max=given.u_max,
        speeds=speeds,
        target=work.target,
    )
    is_flipping = len(work.allowed) > 0 and _write_allowed(problem, R_start)
    if recovering or is_flipping:
        allow_any_tilt(work.allowed)
    cost, iterations, closeness = _warm_start(last, problem)
    _regularise(closeness, recovering or is_flipping, problem)
    return cost, iterations, is_flipping


@compiled
def _write_allowed(problem: Problem, R_start: kernels.Matrix) -> bool:
    """Pull the target closer, and write what limits allow along it; return whether it flips."""
    given, state, work = problem.given, problem.state, problem.work
    first = kernels.vector(work.target[0].p_WB)
    pull_target_closer(given, state.state, work.target)
    if len(work.progress.pull) > 0:
        pull = kernels.plus(kernels.vector(work.target[0].p_WB), kernels.scaled(-1.0, first))
        kernels.store_vector(pull, work.progress.pull)
    allow(
        given,
        sent=state.sent,
        since=state.since_sent,
        target=work.target,
        allowed=work.allowed,
    )
    return flips(given, R_start, work.target)


@compiled
def _warm_start(last: tuple[float, float], problem: Problem) -> tuple[float, int, float]:
    """Linearise along the best start; return its cost, the iterations, and the closeness."""
    elapsed, last_cost = last
    planned = problem.work.plan.deviation
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
    elapsed_ns: int,
    samples: RecordArray[SampleRecord],
    prediction: RecordArray[Prediction],
    is_flipping: bool,
    settings: RecordArray[Settings],
    workspace: Workspace,
    stages: HorizonStages,
) -> float:
    """Write the QP about the last plan, for another iteration; return the plan's cost."""
    problem = Problem(elapsed_ns, samples, prediction[()], settings[()], workspace, stages)
    planned = problem.work.plan.deviation
    if len(workspace.progress.plan) > 0:
        workspace.progress.nominal[:] = workspace.progress.plan
    cost, closeness = _linearise_along(planned, 0.0, problem)
    _regularise(closeness, is_flipping, problem)
    return cost


@compiled
def _regularise(closeness: float, is_flipping: bool, problem: Problem) -> None:
    """Make changes of the plan cost something, where there are limits."""
    given, work = problem.given, problem.work
    if len(work.allowed) > 0:
        steepest = regularise(
            given.R,
            prices=work.prices,
            closeness=closeness,
            steep=math.inf if is_flipping else given.steep,
            stages=problem.stages,
        )
        if len(work.progress.nominal) > 0:
            regularise_progress(given.progress_weight, steepest, problem.stages)


@compiled
def _linearise_along(deviation: Array, elapsed: float, problem: Problem) -> tuple[float, float]:
    """Write the QP about a plan shifted by ``elapsed`` stages; return its cost and closeness.

    That is how close it comes to a limit.
    """
    cost, work = _linearise(deviation, elapsed, problem), problem.work
    if len(work.allowed) == 0:
        return cost, 0.0
    paid, closeness = write_limits(
        work.places,
        target=work.target,
        plan=work.nominal,
        allowed=work.allowed,
        prices=work.prices,
        half_spaces=work.half_spaces,
        stages=problem.stages,
    )
    return cost + paid, closeness


@compiled
def _linearise(deviation: Array, elapsed: float, problem: Problem) -> float:
    """Write tracking cost and dynamics of the QP; return the cost."""
    given, target, plan = problem.given, problem.work.target, problem.work.nominal
    u_min, u_max, stages = given.u_min, given.u_max, problem.stages
    progress = problem.work.progress
    if len(progress.nominal) > 0:
        follow_path(
            problem.elapsed_ns, problem.samples, given.step, progress.nominal, progress, target
        )
    free, errors = np.empty_like(plan.inputs), np.empty((len(target), TANGENT_SIZE))
    shift(deviation, elapsed, plan.deviation)
    apply_bounds(target, plan, u_min=u_min, u_max=u_max)
    mark_free(target, plan, free)
    jacobians(
        problem.state.parameters,
        given.step,
        inputs=plan.inputs,
        free=free,
        start=problem.state.state,
        states=plan.states,
        A=stages.A,
        B=stages.B,
    )
    cost = tracking_cost(given, plan.states, target, plan.deviation, errors)
    quadratic_cost(given, errors, stages.H, stages.g)
    for i in range(len(target)):
        for k in range(INPUT_SIZE):
            planned = target[i].mean_input[k] + plan.deviation[i, k]
            stages.R[i, k] = given.R[k]
            stages.r[i, k] = given.R[k] * plan.deviation[i, k]
            # Nothing changes is always allowed.
            stages.lower[i, k] = min(u_min[k] - planned, 0.0)
            stages.upper[i, k] = max(u_max[k] - planned, 0.0)
    if len(progress.nominal) > 0:
        write_progress(given, errors, progress, stages)
        cost += progress_cost(given, progress.nominal)
    return cost


@compiled
def line_search(
    elapsed_ns: int,
    samples: RecordArray[SampleRecord],
    prediction: RecordArray[Prediction],
    change: Array,
    cost: float,
    settings: RecordArray[Settings],
    workspace: Workspace,
    inputs: Array,
    p_WB: Array,
    R_WB: Array,
) -> float:
    """Write the plan after the longest step along a ``change`` (N, nu) that lowers a cost.

    Where none does, that is the nominal plan. ``inputs`` (N M, 4) are its commands, ``p_WB``
    (N + 1, 3) and ``R_WB`` (N + 1, 3, 3) where it leads. Returns the cost reached.
    """
    given, state = settings[()], prediction[()]
    path = elapsed_ns, samples
    reached = _search(change, cost, state, given, workspace, path)
    _copy_plan(workspace.plan, given.rate_gain, state.parameters, inputs, p_WB=p_WB, R_WB=R_WB)
    return reached


@compiled
def _search(
    change: Array,
    cost: float,
    state: Prediction,
    given: Settings,
    work: Workspace,
    path: tuple[int, RecordArray[SampleRecord]],
) -> float:
    target, before, tried, progress = work.target, work.nominal, work.plan, work.progress
    errors, inputs = np.empty((len(change), TANGENT_SIZE)), np.empty((len(change), INPUT_SIZE))
    for length in _STEP_LENGTHS:
        for i in range(len(change)):
            for k in range(INPUT_SIZE):
                tried.deviation[i, k] = before.deviation[i, k] + length * change[i, k]
        apply_bounds(target, tried, u_min=given.u_min, u_max=given.u_max)
        roll_out(
            state.parameters,
            given.step,
            inputs=tried.inputs,
            start=state.state,
            states=tried.states,
        )
        if len(progress.plan) > 0:
            for i in range(len(change)):
                speed = progress.nominal[i] + length * change[i, SPEED_INPUT]
                progress.plan[i] = kernels.clamp(speed, given.speed_min, given.speed_max)
            follow_path(path[0], path[1], given.step, progress.plan, progress, target)
        reached = tracking_cost(given, tried.states, target, tried.deviation, errors)
        reached += progress_cost(given, progress.plan)
        if len(work.allowed) > 0:
            for i in range(len(inputs)):
                for k in range(INPUT_SIZE):
                    inputs[i, k] = target[i].mean_input[k] + tried.deviation[i, k]
            reached += penalty(tried.states, inputs, work.allowed, work.prices, work.half_spaces)
        if reached < cost:
            return reached
    copy(work.nominal, work.plan)
    progress.plan[:] = progress.nominal
    return cost


@compiled
def _copy_plan(
    plan: PlannedTrajectory,
    rate_gain: Array,
    model: ModelParameters,
    inputs: Array,
    p_WB: Array,
    R_WB: Array,
) -> None:
    """Write the inputs (N M, 4) of a plan as commands, and its poses 0 to N.

    Inputs are what the rates follow: offset and gain are taken off.
    """
    commands = plan.inputs.reshape((len(inputs), INPUT_SIZE))
    for i in range(len(inputs)):
        inputs[i, U_THROTTLE] = commands[i, U_THROTTLE]
        offset = rate_offset_at(model, commands[i, U_THROTTLE])
        for k in range(3):
            inputs[i, U_RATE + k] = (commands[i, U_RATE + k] - offset[k]) / rate_gain[k]
    for i in range(len(p_WB)):
        body = body_in(plan.states[i])
        kernels.store_vector(body.p, p_WB[i])
        kernels.store_matrix(body.R, R_WB[i])

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The formulation ``manifold``: SQP on the problem of :mod:`.problem`, and ``contouring``.

An iteration writes the QP about a plan and takes the step δ + α dδ, with the largest of a few α
that lowers the true cost, so a plan is never worse than the previous plan. As a rule one iteration
is enough: the real-time iteration of Diehl et al. (2005), warm started with the last plan, shifted
by the elapsed time. After a jump of the reference the cheaper of two plans is used, the shifted
plan or the reference's inputs, and a few iterations follow.

The iterates stay in the workspace between calls. So a tick calls compiled code twice, before and
after the solver: a call with cold caches costs up to a fifth of the linearisation.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.parameters import rate_offset_at
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.reference_window import SampleRecord, packed
from quad_mpc_ros.control.model.rollout import SUBSTEPS, roll_out
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.model.state import INPUT_SIZE, U_RATE, U_THROTTLE
from quad_mpc_ros.control.model.target import TargetStage, sample_target
from quad_mpc_ros.control.ocp.horizon_qp import HorizonPattern, HorizonStages
from quad_mpc_ros.control.ocp.limits import Limits, compute_bounds, flips, saturate_position_error
from quad_mpc_ros.control.ocp.plan import Plan, PlannedTrajectory, apply_bounds, shift
from quad_mpc_ros.control.ocp.problem import OcpArrays, Problem, pattern_of, plan_cost, write_qp
from quad_mpc_ros.control.ocp.progress import (
    SPEED_INPUT,
    SPEED_MAX,
    SPEED_MIN,
    ProgressBuffers,
    follow_path,
)
from quad_mpc_ros.control.ocp.settings import settings_of

_COLD_ITERATIONS = 5
_JUMP_ITERATIONS = 3
# A shifted plan whose cost has grown by this much meets a reference that has jumped.
_JUMP_FACTOR, _JUMP_FLOOR = 4.0, 0.1
_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
_CONVERGENCE_RATIO = 0.95  # of the cost, above which the plan has converged
_FLIP_RECOVERY_NS = 500_000_000  # after a flip of the reference the vehicle may be behind


class ManifoldProblem:
    """Tracks the reference along the predicted trajectory; keeps the last plan between ticks.

    :func:`begin` and :func:`relinearise` write the nominal plan; :func:`line_search` alone writes
    the last plan, which is therefore kept if the solver fails. Half-spaces on the position are in
    a separate problem, which shares target and plans, so that without a corridor the unconstrained
    problem is solved.
    """

    is_deviation = True
    """The QP's variables are changes of a plan: the solver starts from zero."""

    def __init__(self, config: MpcConfig) -> None:
        self._config = config
        self._settings = settings_of(config)
        self.has_progress_state = config.formulation == "contouring"
        steps, settings = config.horizon_steps, self._settings[()]
        limits = Limits.zeros(settings, steps)
        self._unconstrained = OcpArrays(
            target=TargetStage.zeros(steps),
            nominal=PlannedTrajectory.zeros(steps),
            plan=PlannedTrajectory.zeros(steps),
            progress=ProgressBuffers.zeros(steps if self.has_progress_state else 0),
            limits=limits,
            stages=HorizonStages.zeros(*pattern_of(config, limits).sizes),
            R=np.zeros(INPUT_SIZE),
        )
        limits = Limits.zeros(settings, steps, half_spaces=config.half_spaces)
        stages = HorizonStages.zeros(*pattern_of(config, limits).sizes)
        self._constrained = self._unconstrained._replace(limits=limits, stages=stages)
        self._window: ReferenceWindow | None = None
        self._samples = SampleRecord.zeros(0)
        self._flips_until_ns, self._flipping = 0, False
        self._last = 0, math.nan  # stamp and cost of the last plan
        # Cost of the present iterate, iterations left, and whether the stages are about it.
        self._cost, self._iterations, self._linearised = 0.0, 0, False

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply weights and bounds; the last plan is kept."""
        self._config = config
        self._settings[()] = settings_of(config)[()]

    def pattern(self, *, constrained: bool = False) -> HorizonPattern:
        """Return the sparsity of the QP, with corridor if ``constrained``."""
        work = self._constrained if constrained else self._unconstrained
        return pattern_of(self._config, work.limits)

    def begin(
        self, state: PredictedState, window: ReferenceWindow, corridor: Corridor | None = None
    ) -> None:
        """Set the target, and warm start: shift the last plan, or hold the reference's inputs."""
        work, step = self._unconstrained, self._config.horizon_step
        if corridor is not None:
            work = self._constrained
            work.limits.set_corridor(corridor, stamp_ns=state.stamp_ns, step=step)
        if window is not self._window:  # one serves several ticks
            self._window, self._samples = window, packed(window)
        self._stamp_ns = state.stamp_ns
        self._problem = Problem(
            elapsed_ns=state.stamp_ns - window.stamp_ns,
            samples=self._samples,
            prediction=state.prediction,
            settings=self._settings,
            work=work,
        )
        last_ns, last_cost = self._last
        recovering = 0 <= self._flips_until_ns - state.stamp_ns <= _FLIP_RECOVERY_NS
        self._cost, self._iterations, is_flipping = begin(
            self._problem,
            elapsed=(state.stamp_ns - last_ns) * 1e-9 / step,
            last_cost=last_cost,
            recovering=recovering,
        )
        if is_flipping:
            self._flips_until_ns = state.stamp_ns + _FLIP_RECOVERY_NS
        self._flipping = recovering or is_flipping
        # The roll-out for the cost has linearised on the way.
        self._linearised = True

    def linearise(self) -> HorizonStages:
        """Return the QP in the change of the current iterate."""
        if not self._linearised:
            cost = relinearise(self._problem, is_flipping=self._flipping)
            if len(self._problem.work.limits.bounds) > 0:  # the weights have changed
                self._cost = cost
        self._linearised = False
        return self._problem.work.stages

    def line_search(self, inputs: Array, states: Array) -> tuple[Plan, bool]:
        """Return the plan after the longest step that lowers the true cost, and whether to stop.

        ``inputs`` (N, nu) and ``states`` 1 to N (N, nx) are the QP's solution. The arrays of the
        plan are copies.
        """
        plan, step = self._problem.work.plan, self._config.horizon_step
        commands = np.empty((plan.inputs.size // INPUT_SIZE, INPUT_SIZE))
        cost = line_search(self._problem, inputs, self._cost, commands)
        converged = not cost < _CONVERGENCE_RATIO * self._cost
        self._cost, self._iterations = cost, self._iterations - 1
        self._last = self._stamp_ns, cost
        flown = Plan(
            self._stamp_ns,
            step,
            step / SUBSTEPS,
            commands,
            p_WB=plan.states["p_WB"].copy(),
            R_WB=plan.states["R_WB"].copy(),
            speeds=self._problem.work.progress.plan.copy(),
        )
        return flown, converged or self._iterations == 0


@compiled
def begin(
    problem: Problem, elapsed: float, last_cost: float, recovering: bool
) -> tuple[float, int, bool]:
    """Write target and bounds, and the QP about the best initial plan.

    Args:
        problem: Target, bounds, the nominal plan and the QP are written.
        elapsed: Flown part of the last plan, in stages.
        last_cost: Cost of the last plan, NaN without a plan.
        recovering: Whether the reference flipped recently.

    Returns:
        Cost of the initial plan, number of iterations, and whether the reference flips.
    """
    settings, work = problem.settings[()], problem.work
    work.R[:] = settings.R
    scale = problem.prediction[()].rate_weight_scale
    for k in range(U_RATE, U_RATE + 3):
        work.R[k] = max(scale * settings.R[k], settings.R_least[k])
    planned, speeds = work.plan.deviation, work.progress.nominal
    if len(speeds) > 0:
        plan = work.progress.plan
        shift(plan.reshape((-1, 1)), elapsed, speeds.reshape((-1, 1)))
    R_start = sample_target(
        problem.elapsed_ns,
        problem.samples,
        problem.prediction[()].parameters,
        settings.step,
        u_min=settings.u_min,
        u_max=settings.u_max,
        speeds=speeds,
        target=work.target,
    )
    has_limits = len(work.limits.bounds) > 0
    is_flipping = has_limits and flips(settings, R_start, work.target)
    flipped = recovering or is_flipping
    if has_limits:
        _limit(problem, flipped)
    if math.isnan(last_cost):
        cost = _linearise_along(np.zeros_like(planned), 0.0, problem, flipped)
        return cost, _COLD_ITERATIONS, is_flipping
    cost = _linearise_along(planned, elapsed, problem, flipped)
    if cost <= _JUMP_FACTOR * last_cost + _JUMP_FLOOR:
        return cost, 1, is_flipping
    held = _linearise_along(np.zeros_like(planned), 0.0, problem, flipped)
    if not held < cost:
        held = _linearise_along(planned, elapsed, problem, flipped)
    return held, _JUMP_ITERATIONS, is_flipping


@compiled
def _limit(problem: Problem, any_tilt: bool) -> None:
    """Saturate the position error of the target, and write the bounds along the target."""
    settings, work, prediction = problem.settings[()], problem.work, problem.prediction[()]
    first = kernels.vector(work.target[0].p_WB)
    saturate_position_error(settings, prediction.state, work.target)
    if len(work.progress.shift) > 0:
        moved = kernels.plus(kernels.vector(work.target[0].p_WB), kernels.scaled(-1.0, first))
        kernels.store_vector(moved, work.progress.shift)
    compute_bounds(settings, work.target, any_tilt, work.limits.bounds)


@compiled
def relinearise(problem: Problem, is_flipping: bool) -> float:
    """Write the QP about the last plan, for another iteration; return the plan's cost."""
    work = problem.work
    work.progress.nominal[:] = work.progress.plan
    return _linearise_along(work.plan.deviation, 0.0, problem, is_flipping)


@compiled
def _linearise_along(
    deviation: Array, elapsed: float, problem: Problem, is_flipping: bool
) -> float:
    """Write the QP about a plan shifted by ``elapsed`` stages; return its cost."""
    work = problem.work
    _follow_path(problem, work.progress.nominal)
    shift(deviation, elapsed, work.nominal.deviation)
    apply_bounds(problem.settings[()], work.target, work.nominal)
    return write_qp(problem, is_flipping)


@compiled
def _follow_path(problem: Problem, speeds: Array) -> None:
    """Move the target along the reference with speeds (N,), if any."""
    if len(speeds) > 0:
        work, step = problem.work, problem.settings[()].step
        follow_path(problem.elapsed_ns, problem.samples, step, speeds, work.progress, work.target)


@compiled
def line_search(problem: Problem, change: Array, cost: float, commands: Array) -> float:
    """Take the longest step along a ``change`` (N, nu) that lowers the cost; return its cost.

    If no step lowers the cost, the nominal plan is kept. The inputs are written as ``commands``
    (N M, 4), without offset and gain of the rates.
    """
    reached = _search(problem, change, cost)
    model, gain = problem.prediction[()].parameters, problem.settings[()].rate_gain
    commands[:] = problem.work.plan.inputs.reshape((-1, INPUT_SIZE))
    for i in range(len(commands)):
        offset = rate_offset_at(model, commands[i, U_THROTTLE])
        for k in range(3):
            commands[i, U_RATE + k] = (commands[i, U_RATE + k] - offset[k]) / gain[k]
    return reached


@compiled
def _search(problem: Problem, change: Array, cost: float) -> float:
    settings, work, prediction = problem.settings[()], problem.work, problem.prediction[()]
    nominal, tried, progress = work.nominal, work.plan, work.progress
    for length in _STEP_LENGTHS:
        for i in range(len(change)):
            for k in range(INPUT_SIZE):
                tried.deviation[i, k] = nominal.deviation[i, k] + length * change[i, k]
        apply_bounds(settings, work.target, tried)
        roll_out(
            prediction.parameters,
            settings.step,
            inputs=tried.inputs,
            start=prediction.state,
            states=tried.states,
        )
        for i in range(len(progress.plan)):
            speed = progress.nominal[i] + length * change[i, SPEED_INPUT]
            progress.plan[i] = kernels.clamp(speed, SPEED_MIN, SPEED_MAX)
        _follow_path(problem, progress.plan)
        reached = plan_cost(problem)
        if reached < cost:
            return reached
    tried.deviation[:], tried.inputs[:] = nominal.deviation, nominal.inputs
    tried.states[:] = nominal.states
    progress.plan[:] = progress.nominal
    return cost

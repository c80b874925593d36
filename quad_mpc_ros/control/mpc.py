# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plan stage: the SQP loop (linearise, update, solve, line search), and the check of plans."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.guide import Guided
from quad_mpc_ros.control.lie.kernels import infinity_norm
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.ocp.horizon_qp import HorizonQP
from quad_mpc_ros.control.ocp.manifold import ManifoldProblem
from quad_mpc_ros.control.ocp.paper import PaperProblem
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.ocp.qp_solver import QpSolution, QpSolver
from quad_mpc_ros.control.stage import Due, Failure, Stage, StageLog

FORMULATIONS: dict[str, Callable[[MpcConfig], ManifoldProblem | PaperProblem]] = {
    "manifold": ManifoldProblem,
    "contouring": ManifoldProblem,
    "paper": PaperProblem,
}

_MANY_ITERATIONS = 200  # of the solver, over all linearisations of a step


class MpcStep(NamedTuple):
    """Result of one step; ``plan`` is None if the solver failed. ``step_time`` is in seconds.

    ``state`` is the initial state, ``solution`` the last solver result, ``iterations`` and
    ``solve_time`` [s] are sums over all solves.
    """

    plan: Plan | None
    solution: QpSolution
    iterations: int
    solve_time: float
    step_time: float
    state: PredictedState


class Planned(NamedTuple):
    """Result of the stage.

    Attributes:
        step: The step of the MPC, even if its plan cannot be flown; None without a step.
        failure: The reason why no plan can be flown, else None.
    """

    step: MpcStep | None
    failure: Failure | None


class Planner(Stage, ABC):
    """A stage that plans from the estimate along the guided window."""

    commands_rotors = False
    """Whether the plans command rotors in addition to throttle and body rates."""

    @abstractmethod
    def step(self, due: Due, state: PredictedState | Failure, guided: Guided | Failure) -> Planned:
        """Return the plan, or the reason why no plan exists."""


NewPlanner = Callable[[MpcConfig, float, StageLog], Planner]
"""Makes a planner of a configuration and its deadline [s]: the longest step; later plans are
dropped."""


class Mpc(Planner):
    """Model predictive control by sequential quadratic programming, one persistent sparse QP.

    A second QP and solver serve steps with a corridor. The problem owns the stages and plans, the
    QP owns the scaled matrices, and the solver owns its last solution, the warm start. A step owns
    no lasting state.
    """

    def __init__(
        self, config: MpcConfig, deadline: float = math.inf, log: StageLog | None = None
    ) -> None:
        """``deadline`` [s] is the longest step time; later plans are dropped."""
        self._config, self._deadline, self._log = config, deadline, log or StageLog()
        # After this time there is no further iteration, which may take as long again.
        self._iteration_limit = 0.5 * deadline
        self.restart()

    def restart(self) -> None:
        """Replace problem and solvers, for example after an error in one of them."""
        config = self._config
        self._problem = FORMULATIONS[config.formulation](config)
        self._unconstrained = self._prepared(constrained=False)
        # A separate solver, so that commands without a corridor do not depend on the corridor.
        has_corridor = config.half_spaces > 0
        self._constrained = self._prepared(constrained=True) if has_corridor else None

    def _prepared(self, *, constrained: bool) -> tuple[HorizonQP, QpSolver]:
        qp = HorizonQP(self._problem.pattern(constrained=constrained))
        return qp, QpSolver(
            qp,
            self._config.solver,
            time_limit=self._deadline,
            progress=self._problem.has_progress_state and not constrained,
            half_spaces=constrained,
        )

    def solve(
        self,
        state: PredictedState,
        window: ReferenceWindow,
        corridor: Corridor | None = None,
        *,
        started: float | None = None,
    ) -> MpcStep:
        """Compute the plan from a predicted state.

        The plan stays in a ``corridor`` if half-spaces are configured. ``started`` is the start
        time of the deadline [s], by :func:`time.perf_counter`; None starts now.
        """
        started, problem = started or time.perf_counter(), self._problem
        if self._constrained is None or corridor is None:
            corridor, (qp, solver) = None, self._unconstrained
        else:
            qp, solver = self._constrained
        plan: Plan | None = None
        iterations, solve_time = 0, 0.0

        problem.begin(state, window, corridor)
        while True:
            qp.update(problem.linearise())
            solution = solver.solve(from_zero=problem.is_deviation, again=plan is not None)
            iterations += solution.iterations
            solve_time += solution.solve_time
            if not solution.solved:
                break
            plan, converged = problem.line_search(solution.inputs, solution.states)
            # The next step continues from a plan that took long.
            if converged or iterations > _MANY_ITERATIONS:
                break
            if time.perf_counter() - started > self._iteration_limit:
                break

        return MpcStep(
            plan=plan,
            solution=solution,
            iterations=iterations,
            solve_time=solve_time,
            step_time=time.perf_counter() - started,
            state=state,
        )

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply new weights and bounds; pattern, plan and warm start are kept.

        A reset of the estimate requires no change: plans are deviations from reference inputs.
        """
        self._config = config
        self._problem.reconfigure(config)

    def step(self, due: Due, state: PredictedState | Failure, guided: Guided | Failure) -> Planned:
        """Return the plan, or the reason why no plan exists."""
        if isinstance(guided, Failure):
            return Planned(None, guided)
        if isinstance(state, Failure):
            return Planned(None, state)
        window, corridor, _avoidance = guided
        try:
            step = self.solve(state, window, corridor, started=due.started)
        except Exception as error:  # the fallbacks have to fly the vehicle in any case
            self.restart()
            return Planned(None, self._log.no_plan(f"error in the MPC: {error!r}"))
        return Planned(step, self._failure_of(step))

    def _failure_of(self, step: MpcStep) -> Failure | None:
        """Return the reason why the plan of a step cannot be flown, else None."""
        if step.plan is None:
            return self._log.no_plan(f"solver: {step.solution.status}")
        if not infinity_norm(step.plan.inputs) < math.inf:  # also true for NaN
            return self._log.no_plan("the plan is not finite")
        if step.step_time > self._deadline:
            reason = f"late: the plan took {1e3 * step.step_time:.1f} ms"
            return self._log.no_plan(reason, counted="deadline_misses")
        return None

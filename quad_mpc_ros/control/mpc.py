"""The control cycle: predict, linearise, update, solve, line search, plan."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation, EstimateStatus
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.ocp.horizon_qp import HorizonQP
from quad_mpc_ros.control.ocp.manifold import ManifoldProblem
from quad_mpc_ros.control.ocp.paper import PaperProblem
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.ocp.problem import PredictedState, TrackingProblem
from quad_mpc_ros.control.ocp.qp_solver import QpSolution, QpSolver
from quad_mpc_ros.control.safety.fallbacks import Learned

FORMULATIONS: dict[str, Callable[[MpcConfig], TrackingProblem]] = {
    "manifold": ManifoldProblem,
    "contouring": ManifoldProblem,
    "paper": PaperProblem,
}


class MpcStep(NamedTuple):
    """Outcome of one cycle; ``plan`` is None when the solver failed. ``step_time`` in seconds.

    ``state`` is what it began with, ``estimate`` the status of its estimate; ``solution`` is the
    last solve's, ``iterations`` and ``solve_time`` [s] are summed over all.
    """

    plan: Plan | None
    solution: QpSolution
    iterations: int
    solve_time: float
    step_time: float
    state: PredictedState
    estimate: EstimateStatus


class Mpc:
    """Model predictive control by sequential quadratic programming, one persistent sparse QP.

    The problem owns the stages and its plans, the QP the scaled matrices, the solver the last
    solution, from which it starts; the step owns nothing that outlives it.
    """

    def __init__(
        self,
        config: MpcConfig,
        *,
        ground: GroundDetector | None = None,
        deadline: float = math.inf,
    ) -> None:
        self._config, self._deadline = config, deadline
        # Iterations beyond the first have to leave time for one more.
        self._enough = 0.5 * deadline
        self._delay_compensation = DelayCompensation(config, ground=ground)
        self._begin()

    def _begin(self) -> None:
        config = self._config
        self._problem = FORMULATIONS[config.formulation](config)
        self._anywhere = self._prepared(within=False)
        # A solver of its own: without a corridor the other one computes the same bits as ever.
        has_room = config.half_spaces > 0
        self._within = self._prepared(within=True) if has_room else self._anywhere
        self._failed = False

    def _prepared(self, *, within: bool) -> tuple[HorizonQP, QpSolver]:
        qp = HorizonQP(self._problem.pattern(within=within))
        return qp, QpSolver(
            qp,
            self._config.solver,
            time_limit=self._deadline,
            progress=self._problem.gives_way and not within,
        )

    def step(
        self,
        odometry: OdometrySample,
        window: ReferenceWindow,
        corridor: Corridor | None = None,
        *,
        late_ns: int = 0,
    ) -> MpcStep:
        """Compute the plan for an odometry (twist in the body frame) and a reference window.

        It stays in a ``corridor``, if the configuration has half-spaces for it. ``late_ns`` is by
        how much the odometry came later than usual.
        """
        started = time.perf_counter()
        state = self._delay_compensation.predict(odometry, late_ns=late_ns)
        return self.solve(state, window, corridor, started=started)

    def step_unseen(
        self, stamp_ns: int, window: ReferenceWindow, corridor: Corridor | None = None
    ) -> MpcStep | None:
        """Compute the plan from where the vehicle should be at a time without odometry.

        None if it has not been seen before that.
        """
        started = time.perf_counter()
        state = self._delay_compensation.foresee(stamp_ns)
        return None if state is None else self.solve(state, window, corridor, started=started)

    def solve(
        self,
        state: PredictedState,
        window: ReferenceWindow,
        corridor: Corridor | None = None,
        *,
        started: float | None = None,
    ) -> MpcStep:
        """Compute the plan from a predicted state; ``started`` is when the step did [s]."""
        started = time.perf_counter() if started is None else started
        if self._within is self._anywhere:
            corridor = None
        problem, (qp, solver) = self._problem, self._anywhere if corridor is None else self._within
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
            converged = problem.line_search(solution.inputs, solution.states)
            plan = problem.plan()
            if converged or time.perf_counter() - started > self._enough:
                break

        self._failed = False
        return MpcStep(
            plan=plan,
            solution=solution,
            iterations=iterations,
            solve_time=solve_time,
            step_time=time.perf_counter() - started,
            state=state,
            estimate=self.estimate,
        )

    def begin_anew(self) -> None:
        """Start again with a new problem and solver after an error in the step.

        What was learned, the commands sent and the engagement stay, unless the step before ended
        with an error, too: then the error may be there.
        """
        failed_before = self._failed
        if failed_before:
            self._delay_compensation = self._delay_compensation.renewed()
        self._begin()
        self._failed = not failed_before

    def learned(self) -> Learned:
        """Return what has been learned of the vehicle that a fallback can use."""
        model = self._delay_compensation.estimated()
        return Learned(thrust_scale=float(model.thrust_scale), a_W=tuple(model.a_W.tolist()))

    @property
    def estimate(self) -> EstimateStatus:
        """The status of the estimate."""
        return self._delay_compensation.status

    def sent(self, command: Input, *, stamp_ns: int) -> None:
        """Record which command was sent, by whichever rung of the ladder."""
        self._delay_compensation.record(command, stamp_ns=stamp_ns)

    def feel(self, sample: ImuSample) -> None:
        """Take what an accelerometer measured."""
        self._delay_compensation.feel(sample)

    def engage(self, engaged: bool) -> None:
        """Set whether what is sent acts on the vehicle."""
        self._delay_compensation.engage(engaged)

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate.

        The plan is one of deviations from the reference's inputs, and moves with the reference.
        """
        self._delay_compensation.reset_estimate(reset)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over new weights and bounds; pattern, plan and warm start stay."""
        self._config = config
        self._problem.reconfigure(config)
        self._delay_compensation.reconfigure(config)

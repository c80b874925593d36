"""The control cycle: predict, linearise, update, solve, apply."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

from quad_mpc_ros.estimation.delay_compensation import StatePredictor
from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.model.state import Input
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.ocp.formulation import Formulation, Plan
from quad_mpc_ros.ocp.horizon_qp import HorizonQP
from quad_mpc_ros.ocp.manifold import ManifoldFormulation
from quad_mpc_ros.ocp.paper import PaperFormulation
from quad_mpc_ros.ocp.qp_solver import QpSolution, QpSolver
from quad_mpc_ros.ocp.situation import Situation

FORMULATIONS: dict[str, Callable[[MpcConfig], Formulation]] = {
    "manifold": ManifoldFormulation,
    "paper": PaperFormulation,
}


class MpcStep(NamedTuple):
    """Outcome of one cycle; ``plan`` is None when the solver failed. ``step_time`` in seconds.

    ``situation`` is what it began with,
    ``solution`` is the last solve's, ``iterations`` and ``solve_time`` [s] are summed over all.
    """

    plan: Plan | None
    solution: QpSolution
    iterations: int
    solve_time: float
    step_time: float
    situation: Situation


class Mpc:
    """Linear MPC on the error state, one persistent sparse QP."""

    def __init__(self, config: MpcConfig, *, deadline: float = math.inf) -> None:
        self._predictor = StatePredictor(config)
        self._formulation = FORMULATIONS[config.formulation](config)
        self._qp = HorizonQP(self._formulation.pattern())
        # Iterations beyond the first have to leave time for one more.
        self._enough = 0.5 * deadline
        self._solver = QpSolver(self._qp, config.solver, time_limit=deadline)

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> MpcStep:
        """Compute the plan for an odometry (twist in the body frame) and a reference window."""
        started = time.perf_counter()
        situation = self._predictor.predict(odometry)
        horizon = self._formulation.linearise(situation, window)
        plan: Plan | None = None
        iterations, solve_time = 0, 0.0
        while True:
            self._qp.update(horizon.stages)
            solution = self._solver.solve(from_zero=horizon.is_deviation)
            iterations += solution.iterations
            solve_time += solution.solve_time
            if not solution.solved:
                break
            plan, again = horizon.advance(*self._qp.split(solution.z))
            if again is None or time.perf_counter() - started > self._enough:
                break
            horizon = again
        return MpcStep(
            plan=plan,
            solution=solution,
            iterations=iterations,
            solve_time=solve_time,
            step_time=time.perf_counter() - started,
            situation=situation,
        )

    def sent(self, command: Input, *, stamp_ns: int) -> None:
        """Tell the controller which command was sent, by whichever rung of the ladder."""
        self._predictor.record(command, stamp_ns=stamp_ns)

    def engage(self, engaged: bool) -> None:
        """Tell the controller whether what is sent acts on the vehicle."""
        self._predictor.engage(engaged)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over new weights and bounds; pattern, plan and warm start stay."""
        self._formulation.reconfigure(config)
        self._predictor.reconfigure(config)

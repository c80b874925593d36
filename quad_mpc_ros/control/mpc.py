"""The control cycle: predict, linearise, update, solve, apply."""

from __future__ import annotations

import time
from dataclasses import dataclass

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.formulation import Formulation, Plan
from quad_mpc_ros.control.horizon_qp import HorizonQP
from quad_mpc_ros.control.paper import PaperFormulation
from quad_mpc_ros.control.solver import QpSolution, QpSolver
from quad_mpc_ros.core.messages import OdometrySample, ReferenceWindow
from quad_mpc_ros.core.state import Input, State, state_from_odometry

FORMULATIONS: dict[str, type[PaperFormulation]] = {"paper": PaperFormulation}


@dataclass(frozen=True, kw_only=True, eq=False)
class MpcStep:
    """Outcome of one cycle; ``plan`` is None when the solver failed. ``step_time`` in seconds."""

    plan: Plan | None
    solution: QpSolution
    step_time: float


class Mpc:
    """Linear MPC on the error state, one persistent sparse QP."""

    def __init__(self, config: MpcConfig) -> None:
        self._throttle_sent = config.vehicle().hover_throttle
        self._configure(config)
        self._qp = HorizonQP(self._formulation.pattern())
        self._solver = QpSolver(self._qp, config.solver)

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> MpcStep:
        """Compute the plan for an odometry (twist in the body frame) and a reference window."""
        started = time.perf_counter()
        x = self._predict(odometry)
        horizon = self._formulation.linearise(
            x, stamp_ns=odometry.stamp_ns, window=window, throttle=self._throttle_sent
        )
        self._qp.update(horizon.stages)
        solution = self._solver.solve()
        plan = horizon.plan(*self._qp.split(solution.z)) if solution.solved else None
        return MpcStep(plan=plan, solution=solution, step_time=time.perf_counter() - started)

    def sent(self, command: Input) -> None:
        """Tell the controller which command was sent, by whichever rung of the ladder."""
        self._throttle_sent = command.throttle

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over new weights and bounds; pattern and warm start stay."""
        self._configure(config)

    def _configure(self, config: MpcConfig) -> None:
        self._formulation: Formulation = FORMULATIONS[config.formulation](config)

    def _predict(self, odometry: OdometrySample) -> State:
        """Return the state at which the command will act: the paper has no delay."""
        return state_from_odometry(odometry)

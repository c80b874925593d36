"""The plan stage: the MPC, and the check of its plans."""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.guide import Guided
from quad_mpc_ros.control.lie.kernels import infinity_norm
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.mpc import Mpc, MpcStep
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.stage import Due, Failure, Stage
from quad_mpc_ros.control.stage_log import StageLog


class Planned(NamedTuple):
    """Result of the stage.

    Attributes:
        step: The step of the MPC, even if its plan cannot be flown; None without a step.
        failure: The reason why no plan can be flown, else None.
    """

    step: MpcStep | None
    failure: Failure | None

    @property
    def plan(self) -> Plan | None:
        """The plan to fly."""
        return None if self.step is None or self.failure is not None else self.step.plan


class PlanStage(Stage):
    """Plans from the estimate along the guided window."""

    def __init__(self, config: MpcConfig, *, deadline: float, log: StageLog) -> None:
        """``deadline`` [s] is the longest step time; later plans are dropped."""
        self._log, self._deadline = log, deadline
        self._mpc = Mpc(config, deadline=deadline)

    def step(self, due: Due, state: PredictedState | Failure, guided: Guided | Failure) -> Planned:
        """Return the plan, or the reason why no plan exists."""
        if isinstance(guided, Failure):
            return Planned(None, guided)
        if isinstance(state, Failure):
            return Planned(None, state)
        window, corridor, _avoidance = guided
        try:
            step = self._mpc.solve(state, window, corridor, started=due.started)
        except Exception as error:  # the fallbacks have to fly the vehicle in any case
            self._mpc.restart()
            return Planned(None, self._log.solver_failure(f"error in the MPC: {error!r}"))
        return Planned(step, self._failure_of(step))

    def _failure_of(self, step: MpcStep) -> Failure | None:
        """Return the reason why the plan of a step cannot be flown, else None."""
        if step.plan is None:
            return self._log.solver_failure(f"solver: {step.solution.status}")
        if not infinity_norm(step.plan.inputs.ravel()) < math.inf:  # also true for NaN
            return self._log.solver_failure("the plan is not finite")
        if step.step_time > self._deadline:
            return self._log.deadline_miss(f"late: the plan took {1e3 * step.step_time:.1f} ms")
        return None

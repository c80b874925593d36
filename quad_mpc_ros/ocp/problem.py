"""What the SQP loop asks of a formulation of the optimal control problem.

    problem.begin(state, window)
    repeat: stages = problem.linearise(), solve the QP, problem.line_search(solution)
    plan = problem.plan()

:class:`~quad_mpc_ros.control.mpc.Mpc` runs it; ``docs/equations.md`` has the formulations.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from quad_mpc_ros.lie import Array
from quad_mpc_ros.model.parameters import ModelParameters, parameters_in, rate_offset_at
from quad_mpc_ros.model.rollout import ACTUATORS, P_WB, R_WB, V_WB_W
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.model.state import State
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.ocp.plan import Plan
from quad_mpc_ros.ocp.stages import HorizonPattern, HorizonStages


class PredictedState(NamedTuple):
    """The state at ``stamp_ns``, when the command that is computed now will act.

    ``row`` (19,) is laid out as in :mod:`quad_mpc_ros.model.rollout`, with the throttle and the
    rates that the vehicle will have then; ``sent`` (4,) is what was commanded last, and
    ``since_sent`` [s] the time since the odometry that it answered, infinity before the first
    one; ``parameters`` (29,) are what is believed of the vehicle
    (:mod:`quad_mpc_ros.model.parameters`).
    """

    stamp_ns: int
    row: Array
    parameters: Array
    sent: Array
    since_sent: float

    @property
    def x(self) -> State:
        """The state as the paper has it, with the velocity in the body."""
        rotation = self.row[R_WB].reshape(3, 3)
        return State(p_WB=self.row[P_WB], v_WB_B=rotation.T @ self.row[V_WB_W], R_WB=rotation)

    @property
    def rate_offset(self) -> tuple[float, float, float]:
        """What the rates have beyond their commands at the throttle of the state [rad/s]."""
        return rate_offset_at(self.parameters, self.row[ACTUATORS.start])

    @property
    def model(self) -> ModelParameters:
        """The parameters by their names."""
        return parameters_in(self.parameters)


class TrackingProblem(Protocol):
    """Tracks a reference over a horizon: a sequence of QPs, and the plan that they end in.

    It owns the stages that it returns, and overwrites them with each linearisation.
    """

    is_deviation: bool
    """Whether the QP's variables are the change of a plan: the solver starts from zero then."""

    def pattern(self) -> HorizonPattern:
        """Return the sparsity and the natural sizes of the variables."""
        ...

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed weights and bounds."""
        ...

    def begin(self, state: PredictedState, window: ReferenceWindow) -> None:
        """Take a state and a reference, and choose where the first iteration starts."""
        ...

    def linearise(self) -> HorizonStages:
        """Return the numbers of the QP about the present iterate."""
        ...

    def line_search(self, inputs: Array, states: Array) -> bool:
        """Go on along the QP's solution, as far as it helps; return whether that is the end.

        ``inputs`` (N, nu) and ``states`` 1 to N (N, nx) are in physical units.
        """
        ...

    def plan(self) -> Plan:
        """Return the plan of the last line search."""
        ...

"""What the SQP loop asks of a formulation of the optimal control problem.

    problem.begin(state, window)
    repeat: stages = problem.linearise(), solve the QP, problem.line_search(solution)
    plan = problem.plan()

:class:`~quad_mpc_ros.control.mpc.Mpc` runs it; ``docs/equations.md`` has the formulations.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol, cast

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector4
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.parameters import ModelParameters, rate_offset_at
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.model.state import State
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.ocp.stages import HorizonPattern, HorizonStages


class Prediction(Record):
    """What is predicted of the vehicle for the time when the next command acts."""

    state: StateRecord  # with the throttle and the rates that it will have
    parameters: ModelParameters  # as estimated
    # Throttle and rates [rad/s] commanded last, with the offset that the rates have.
    sent: Vector4
    since_sent: float  # s, since the odometry that it answered; infinity before the first


class PredictedState(NamedTuple):
    """The state at ``stamp_ns``, when the command that is computed now will act."""

    stamp_ns: int
    prediction: RecordArray[Prediction]

    @classmethod
    def at_rest(cls, parameters: RecordArray[ModelParameters]) -> PredictedState:
        """Return a state at the origin with the given parameters, before any command."""
        prediction = Prediction.zeros()
        predicted = prediction[()]
        predicted.state.R_WB[:] = np.eye(3)
        predicted.parameters = parameters[()]
        predicted.since_sent = math.inf
        return cls(0, prediction)

    @property
    def sent(self) -> Array:
        """What was commanded last (4,)."""
        return cast(Array, self.prediction["sent"])

    @property
    def x(self) -> State:
        """The state as the paper has it, with the velocity in the body."""
        state = self.prediction["state"]
        rotation = state["R_WB"]
        return State(p_WB=state["p_WB"], v_WB_B=rotation.T @ state["v_WB_W"], R_WB=rotation)

    @property
    def w_WB_B(self) -> Array:
        """The body rates that it will have (3,) [rad/s]."""
        return cast(Array, self.prediction["state"]["w_WB_B"])

    @property
    def rate_offset(self) -> tuple[float, float, float]:
        """What the rates have beyond their commands at the throttle of the state [rad/s]."""
        return _rate_offset(self.prediction)

    @property
    def parameters(self) -> RecordArray[ModelParameters]:
        """The parameters of the model."""
        return cast(RecordArray[ModelParameters], self.prediction["parameters"])


@compiled
def _rate_offset(prediction: RecordArray[Prediction]) -> kernels.Vector:
    predicted = prediction[()]
    return rate_offset_at(predicted.parameters, predicted.state.throttle)


class TrackingProblem(Protocol):
    """Tracks a reference over a horizon: a sequence of QPs, and the plan that they end in.

    It owns the stages that it returns, and overwrites them with each linearisation.
    """

    is_deviation: bool
    """Whether the QP's variables are the change of a plan: the solver starts from zero then."""
    gives_way: bool
    """Whether progress along the reference is among them."""

    def pattern(self, *, within: bool = False) -> HorizonPattern:
        """Return the sparsity and the natural sizes of the variables, ``within`` a corridor."""
        ...

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed weights and bounds."""
        ...

    def begin(
        self, state: PredictedState, window: ReferenceWindow, corridor: Corridor | None = None
    ) -> None:
        """Take a state, a reference and where the vehicle may be, and choose where to start."""
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

"""What the SQP loop asks of a formulation of the optimal control problem.

    problem.begin(state, window)
    repeat: stages = problem.linearise(), solve the QP, problem.line_search(solution)
    plan = problem.plan()

:class:`~quad_mpc_ros.control.mpc.Mpc` runs it; ``docs/equations.md`` has the formulations.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.parameters import (
    VECTOR_SIZE,
    ModelParameters,
    parameters_in,
    rate_offset_at,
)
from quad_mpc_ros.control.model.rollout import ACTUATORS, P_WB, R_WB, ROW_SIZE, V_WB_W
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.model.state import INPUT_SIZE, State
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.ocp.stages import HorizonPattern, HorizonStages

_PARAMETERS = slice(ROW_SIZE, ROW_SIZE + VECTOR_SIZE)
_SENT = slice(_PARAMETERS.stop, _PARAMETERS.stop + INPUT_SIZE)
PREDICTION_SIZE = _SENT.stop + 1


class PredictionParts(NamedTuple):
    """What is predicted of the vehicle: the parts of one vector, see :func:`prediction_in`.

    ``row`` (19,) is its state as in :mod:`.model.rollout`, with the throttle and the
    rates that it will have; ``parameters`` (29,) are what is believed of it
    (:mod:`.model.parameters`); ``sent`` (4,) is what was commanded last, with the
    offset that the rates have, ``since_sent`` [s] the time since the odometry that it answered,
    infinity before the first.
    """

    row: Array
    parameters: Array
    sent: Array
    since_sent: float


@compiled
def prediction_in(vector: Array) -> PredictionParts:
    """Return what is in a vector (53,)."""
    return PredictionParts(vector[0:19], vector[_PARAMETERS], vector[_SENT], vector[_SENT.stop])


class PredictedState(NamedTuple):
    """The state at ``stamp_ns``, when the command that is computed now will act.

    ``vector`` (53,) holds it and what is believed, see :func:`prediction_in`.
    """

    stamp_ns: int
    vector: Array

    @classmethod
    def at_rest(cls, parameters: Array) -> PredictedState:
        """Return a state at the origin with the given parameters (29,), before any command."""
        vector = np.zeros(PREDICTION_SIZE)
        vector[R_WB] = np.eye(3).ravel()
        vector[_PARAMETERS] = parameters
        vector[-1] = math.inf
        return cls(0, vector)

    @property
    def row(self) -> Array:
        """The state (19,)."""
        return self.vector[:ROW_SIZE]

    @property
    def parameters(self) -> Array:
        """What is believed of the vehicle (29,)."""
        return self.vector[_PARAMETERS]

    @property
    def sent(self) -> Array:
        """What was commanded last (4,)."""
        return self.vector[_SENT]

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

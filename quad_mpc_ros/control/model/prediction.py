# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The state predicted for the time when the next command acts."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector4
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.parameters import ModelParameters, rate_offset_at
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.state import State


class Prediction(Record):
    """The vehicle, predicted for the time when the next command acts."""

    state: StateRecord  # including the predicted throttle and rates
    parameters: ModelParameters  # as estimated
    # Last commanded throttle and rates [rad/s], including the offset of the rates.
    sent: Vector4
    rate_weight_scale: float  # factor on the weights of the rates


class PredictedState(NamedTuple):
    """The state at ``stamp_ns``, when the command computed now will act."""

    stamp_ns: int
    prediction: RecordArray[Prediction]

    @classmethod
    def at_rest(cls, parameters: RecordArray[ModelParameters]) -> PredictedState:
        """Return a state at the origin with the given parameters, before any command."""
        prediction = Prediction.zeros()
        predicted = prediction[()]
        predicted.state.R_WB[:] = np.eye(3)
        predicted.parameters = parameters[()]
        predicted.rate_weight_scale = 1.0
        return cls(0, prediction)

    @property
    def sent(self) -> Array:
        """The last command (4,): throttle and rates [rad/s]."""
        return cast(Array, self.prediction["sent"])

    @property
    def x(self) -> State:
        """The state of the paper, with the velocity in the body frame."""
        state = self.prediction["state"]
        rotation = state["R_WB"]
        return State(p_WB=state["p_WB"], v_WB_B=rotation.T @ state["v_WB_W"], R_WB=rotation)

    @property
    def w_WB_B(self) -> Array:
        """The predicted body rates (3,) [rad/s]."""
        return cast(Array, self.prediction["state"]["w_WB_B"])

    @property
    def rate_offset(self) -> tuple[float, float, float]:
        """Offset of the rates from their commands at the throttle of the state [rad/s]."""
        return _rate_offset(self.prediction)

    @property
    def parameters(self) -> RecordArray[ModelParameters]:
        """The parameters of the model."""
        return cast(RecordArray[ModelParameters], self.prediction["parameters"])


@compiled
def _rate_offset(prediction: RecordArray[Prediction]) -> kernels.Vector:
    predicted = prediction[()]
    return rate_offset_at(predicted.parameters, predicted.state.throttle)

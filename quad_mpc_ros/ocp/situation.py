"""What the controller knows at the moment for which it plans."""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.model.rollout import NO_DISTURBANCE, Disturbance, Model, Motion
from quad_mpc_ros.model.state import State


class Situation(NamedTuple):
    """The state at ``stamp_ns``, when the command that is computed now will act.

    ``motion`` is that one state, with the throttle and the rates the vehicle will have then,
    ``throttle_sent`` is the last one commanded, ``model`` and ``disturbance`` are what is believed
    of the vehicle.
    """

    stamp_ns: int
    motion: Motion
    throttle_sent: float
    model: Model
    disturbance: Disturbance = NO_DISTURBANCE

    @property
    def x(self) -> State:
        """The state as the paper has it, with the velocity in the body."""
        R_WB = self.motion.R_WB[0]
        return State(p_WB=self.motion.p_WB[0], v_WB_B=R_WB.T @ self.motion.v_WB_W[0], R_WB=R_WB)

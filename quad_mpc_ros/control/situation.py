"""What the controller knows at the moment for which it plans."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.control.prediction import NO_DISTURBANCE, Disturbance
from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.core.state import State


@dataclass(frozen=True, kw_only=True, eq=False)
class Situation:
    """The state at ``stamp_ns``, when the command that is computed now will act.

    ``w_WB_B`` (3,) [rad/s] and ``throttle`` are the rates and the throttle the vehicle will have
    then, ``throttle_sent`` is the last one commanded, ``disturbance`` is what has been estimated.
    """

    stamp_ns: int
    x: State
    w_WB_B: Array
    throttle: float
    throttle_sent: float
    disturbance: Disturbance = NO_DISTURBANCE

"""What a formulation of the horizon must provide (see ``docs/equations.md``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from quad_mpc_ros.control.horizon_qp import HorizonPattern, HorizonStages
from quad_mpc_ros.core.messages import Array, ReferenceWindow
from quad_mpc_ros.core.state import State


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The trajectory the controller intends to fly, starting at ``stamp_ns``.

    ``inputs`` (N, 4): throttle and body rates held over each step of ``step`` seconds.
    ``p_WB`` (N + 1, 3) [m] and ``R_WB`` (N + 1, 3, 3): the predicted poses, the first is now.
    """

    stamp_ns: int
    step: float
    inputs: Array
    p_WB: Array
    R_WB: Array

    def input_after(self, elapsed: float) -> Array:
        """Return the input (4,) planned for ``elapsed`` seconds on; beyond the end the last."""
        stage = int(elapsed / self.step)
        return np.asarray(self.inputs[min(max(stage, 0), len(self.inputs) - 1)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Horizon:
    """A linearised horizon: the numbers of its QP, and how its solution becomes a plan.

    ``plan`` takes the inputs (N, nu) and the states 1 to N (N, nx) that solve the QP.
    """

    stages: HorizonStages
    plan: Callable[[Array, Array], Plan]


class Formulation(Protocol):
    """Turns a state and a reference into a horizon."""

    def pattern(self) -> HorizonPattern:
        """Return the sparsity and the natural sizes of the variables."""
        ...

    def linearise(
        self, x: State, *, stamp_ns: int, window: ReferenceWindow, throttle: float
    ) -> Horizon:
        """Return the horizon from the state ``x`` at ``stamp_ns``, throttle in force given."""
        ...

"""A plan of the manifold formulation and where it leads, shifted and bounded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import SUBSTEPS, StateRecord
from quad_mpc_ros.control.model.state import INPUT_SIZE
from quad_mpc_ros.control.ocp.target import TargetStage

# How far a command may pass a bound by rounding.
_ROUNDING = 1e-9


class PlannedTrajectory(NamedTuple):
    """A plan of N stages of M substeps, and where it leads.

    ``deviation`` (N, 4) from the reference's mean inputs, ``inputs`` (N, M, 4) inside the bounds,
    ``states`` 0 to N (N + 1,).
    """

    deviation: Array
    inputs: Array
    states: RecordArray[StateRecord]

    @staticmethod
    def zeros(steps: int) -> PlannedTrajectory:
        """Return room for a plan."""
        return PlannedTrajectory(
            np.zeros((steps, INPUT_SIZE)),
            np.zeros((steps, SUBSTEPS, INPUT_SIZE)),
            StateRecord.zeros(steps + 1),
        )


@compiled
def copy(source: PlannedTrajectory, destination: PlannedTrajectory) -> None:
    """Copy a plan."""
    destination.deviation[:] = source.deviation
    destination.inputs[:] = source.inputs
    destination.states[:] = source.states


@compiled
def apply_bounds(
    target: RecordArray[TargetStage], plan: PlannedTrajectory, u_min: Array, u_max: Array
) -> None:
    """Bring a plan inside the bounds, and write its inputs.

    A stage's mean input is brought there first, so that some of it is always free.
    """
    deviation = plan.deviation
    for i in range(len(deviation)):
        for k in range(INPUT_SIZE):
            mean = target[i].mean_input[k]
            deviation[i, k] = kernels.clamp(mean + deviation[i, k], u_min[k], u_max[k]) - mean
            for j in range(SUBSTEPS):
                wanted = target[i].inputs[j, k] + deviation[i, k]
                plan.inputs[i, j, k] = kernels.clamp(wanted, u_min[k], u_max[k])


@compiled
def mark_free(target: RecordArray[TargetStage], plan: PlannedTrajectory, free: Array) -> None:
    """Write one for inputs (N, M, 4) that no bound holds, zero for others."""
    for i in range(len(free)):
        for j in range(SUBSTEPS):
            for k in range(INPUT_SIZE):
                wanted = target[i].inputs[j, k] + plan.deviation[i, k]
                is_free = abs(plan.inputs[i, j, k] - wanted) < _ROUNDING
                free[i, j, k] = 1.0 if is_free else 0.0


@compiled
def shift(inputs: Array, elapsed: float, shifted: Array) -> None:
    """Write inputs (N, 4) as they are ``elapsed`` stages later, the last one held."""
    last = len(inputs) - 1
    elapsed = kernels.clamp(elapsed, 0.0, float(len(inputs)))
    whole = int(elapsed)
    share = elapsed - whole
    for i in range(len(inputs)):
        now, then = min(i + whole, last), min(i + whole + 1, last)
        for k in range(INPUT_SIZE):
            shifted[i, k] = (1.0 - share) * inputs[now, k] + share * inputs[then, k]

"""Plans: the one that the controller intends to fly, and those that the SQP compares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import SUBSTEPS, StateRecord
from quad_mpc_ros.control.model.state import INPUT_SIZE, Input
from quad_mpc_ros.control.model.target import TargetStage
from quad_mpc_ros.control.ocp.settings import ProblemSettings

# How far a command may exceed a bound by rounding, and a duration a step: 0.15 / 0.05 is a little
# less than 3.
_ROUNDING = 1e-9


class Plan(NamedTuple):
    """The trajectory the controller intends to fly, starting at ``stamp_ns``.

    ``inputs`` (K, 4): throttle and body rates held over ``input_step`` seconds each. ``p_WB``
    (N + 1, 3) [m] and ``R_WB`` (N + 1, 3, 3): the predicted poses every ``step`` seconds, the
    first is now. ``speeds`` (N,) are how fast the reference's time passes in each of these steps,
    none (0,) where it passes as on a clock.
    """

    stamp_ns: int
    step: float
    input_step: float
    inputs: Array
    p_WB: Array
    R_WB: Array
    speeds: Array = np.ones(0)

    def given_up(self, since: float, until: float) -> float:
        """Return by how much the reference's time falls behind the clock between two times [s].

        They are counted from the beginning of the plan; beyond its end nothing is given up.
        """
        ends = self.step * np.arange(1, len(self.speeds) + 1)
        spent = np.clip(np.minimum(until, ends) - np.maximum(since, ends - self.step), 0.0, None)
        return float(spent @ (1.0 - self.speeds))

    def command_over(self, elapsed: float, duration: float) -> Input:
        """Return the mean of the inputs planned for a time ``elapsed`` seconds on.

        The last one is held beyond the end.
        """
        begin = max(elapsed, 0.0) / self.input_step
        throttle, *rates = _mean_over(self.inputs, begin, begin + duration / self.input_step)
        return Input(throttle=throttle, w_WB_B=np.array(rates))


@compiled
def _mean_over(inputs: Array, begin: float, end: float) -> tuple[float, float, float, float]:
    """Return the mean of inputs (K, 4), one a unit of time, the last one held."""
    last = len(inputs) - 1
    first = min(int(begin + _ROUNDING), last)
    if end <= first + 1 + _ROUNDING or first == last:
        return inputs[first, 0], inputs[first, 1], inputs[first, 2], inputs[first, -1]  # exactly
    a = b = c = d = 0.0
    for k in range(first, last + 1):
        until = end if k == last else min(end, k + 1.0)
        share = max(until - max(begin, float(k)), 0.0) / (end - begin)
        a += share * inputs[k, 0]
        b += share * inputs[k, 1]
        c += share * inputs[k, 2]
        d += share * inputs[k, -1]
        if until >= end:
            break
    return a, b, c, d


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
        """Return zeros for N stages."""
        return PlannedTrajectory(
            np.zeros((steps, INPUT_SIZE)),
            np.zeros((steps, SUBSTEPS, INPUT_SIZE)),
            StateRecord.zeros(steps + 1),
        )


@compiled
def apply_bounds(
    settings: ProblemSettings, target: RecordArray[TargetStage], plan: PlannedTrajectory
) -> None:
    """Clamp a plan to the bounds, and write its inputs.

    A stage's mean input is clamped first, so that some of it is always free.
    """
    deviation, u_min, u_max = plan.deviation, settings.u_min, settings.u_max
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
    """Write inputs (N, m) as they are ``elapsed`` stages later, the last one held."""
    last = len(inputs) - 1
    elapsed = kernels.clamp(elapsed, 0.0, float(len(inputs)))
    whole = int(elapsed)
    share = elapsed - whole
    for i in range(len(inputs)):
        now, then = min(i + whole, last), min(i + whole + 1, last)
        for k in range(inputs.shape[1]):
            shifted[i, k] = (1.0 - share) * inputs[now, k] + share * inputs[then, k]

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans: the predicted trajectory of the controller, and the iterates of the SQP."""

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

    ``inputs`` (K, 4): throttle and body rates held over ``input_step`` seconds each. ``p_WB`` (N +
    1, 3) [m] and ``R_WB`` (N + 1, 3, 3): the predicted poses every ``step`` seconds, the first
    pose is current. ``speeds`` (N,) are the speeds of the reference's time in these steps, empty
    (0,) for real time. ``rotor_throttles`` (n,) replace the first input if no limit changes it.
    """

    stamp_ns: int
    step: float
    input_step: float
    inputs: Array
    p_WB: Array
    R_WB: Array
    speeds: Array = np.ones(0)
    rotor_throttles: Array | None = None

    def given_up(self, since: float, until: float) -> float:
        """Return the lag of the reference's time behind real time, gained between two times [s].

        Times count from the beginning of the plan; beyond its end the lag is constant.
        """
        ends = self.step * np.arange(1, len(self.speeds) + 1)
        spent = np.clip(np.minimum(until, ends) - np.maximum(since, ends - self.step), 0.0, None)
        return float(spent @ (1.0 - self.speeds))

    def command_over(self, elapsed: float, duration: float) -> Input:
        """Return the mean of the inputs planned for ``elapsed`` seconds later.

        The last input is held beyond the end.
        """
        begin = max(elapsed, 0.0) / self.input_step
        throttle, *rates = _mean_over(self.inputs, begin, begin + duration / self.input_step)
        return Input(throttle=throttle, w_WB_B=np.array(rates))


@compiled
def _mean_over(inputs: Array, begin: float, end: float) -> tuple[float, float, float, float]:
    """Return the mean of inputs (K, 4), one per unit of time, with the last input held."""
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
    """A plan of N stages of M substeps, and the resulting states.

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
    """Clamp a plan to the bounds, and write the inputs.

    A stage's mean input is clamped first, so that a part is always free.
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
    """Write 1 for inputs (N, M, 4) within bounds, 0 for inputs at a bound."""
    for i in range(len(free)):
        for j in range(SUBSTEPS):
            for k in range(INPUT_SIZE):
                wanted = target[i].inputs[j, k] + plan.deviation[i, k]
                is_free = abs(plan.inputs[i, j, k] - wanted) < _ROUNDING
                free[i, j, k] = 1.0 if is_free else 0.0


@compiled
def shift(inputs: Array, elapsed: float, shifted: Array) -> None:
    """Write inputs (N, m) shifted by ``elapsed`` stages, with the last input held."""
    last = len(inputs) - 1
    elapsed = kernels.clamp(elapsed, 0.0, float(len(inputs)))
    whole = int(elapsed)
    share = elapsed - whole
    for i in range(len(inputs)):
        now, then = min(i + whole, last), min(i + whole + 1, last)
        for k in range(inputs.shape[1]):
            shifted[i, k] = (1.0 - share) * inputs[now, k] + share * inputs[then, k]

"""Half-spaces on the position as soft limits: their rows of the QP, and what breaking them costs.

    n_ij' p_i <= b_ij,   i = 1..N,  j = 1..K

at the ends of the stages. All of a stage are eased by one slack, of price c s + 1/2 d s^2, which
pays for the one that is broken most. They are linear in the position, so the rows are exact.

The price c follows the slopes of the tracking cost along the rollout, as those of the other
limits do (:mod:`.limits`): what the cost gains at most by a place beyond the plane, here and by
all that follows. A vehicle that brakes or swerves is held by one or two of the stages alone, and
these pay for what the others gain; hence the factor, which tests find to be exact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.state import P, V
from quad_mpc_ros.control.ocp.horizon_qp import FREE
from quad_mpc_ros.control.ocp.stages import HorizonStages, LimitPattern

SLACK_SIZE = 0.3
"""What a violation typically is [m], and by what the solver measures it."""

_SLOPE, _LEAST_PRICE, _SQUARE = 2.0, 4.0, 1.0
# s, in which a change of the velocity becomes one of the position.
_SWERVE = 0.3


class HalfSpaces(NamedTuple):
    """The half-spaces of a horizon: ``normals`` (N, K, 3), ``offsets`` (N, K), FREE for none.

    ``price`` (1,) is that of the present iterate; ``row`` and ``slack`` are where they stand in a
    stage of the QP.
    """

    normals: Array
    offsets: Array
    price: Array
    row: int
    slack: int

    @staticmethod
    def zeros(steps: int, count: int, *, row: int, slack: int) -> HalfSpaces:
        """Return room for so many a stage."""
        return HalfSpaces(
            np.zeros((steps, count, 3)), np.full((steps, count), FREE), np.zeros(1), row, slack
        )

    def take(self, corridor: Corridor, *, stamp_ns: int, step: float) -> None:
        """Take those that hold at the ends of stages of ``step`` seconds from a stamp on."""
        rows = min(self.offsets.shape[1], corridor.offsets.shape[1])
        since = (stamp_ns - corridor.stamp_ns) * 1e-9
        ends = (since + step * np.arange(1, len(self.offsets) + 1)) / corridor.step
        stages = np.clip(np.rint(ends).astype(np.intp) - 1, 0, len(corridor.offsets) - 1)
        self.offsets[:], self.normals[:] = FREE, 0.0
        self.normals[:, :rows] = corridor.normals[stages, :rows]
        self.offsets[:, :rows] = np.minimum(corridor.offsets[stages, :rows], FREE)


def pattern_of(count: int, *, nx: int, nu: int) -> LimitPattern:
    """Return the entries of so many rows on the position, with ``nx`` states, ``nu`` inputs."""
    mask, state = np.zeros((count, 2 * nu + nx), dtype=bool), 2 * nu
    mask[:, state + P : state + V] = True
    has = min(count, 1)
    return LimitPattern(
        mask=mask,
        slack_of=np.zeros(count, dtype=np.intp),
        slack_size=np.full(has, SLACK_SIZE),
    )


@compiled
def write_half_spaces(
    half_spaces: HalfSpaces,
    states: RecordArray[StateRecord],
    slopes: Array,
    stages: HorizonStages,
) -> None:
    """Write rows and price about states 0 to N (N + 1,), at slopes (N, nx) of the cost there."""
    count = half_spaces.offsets.shape[1]
    if count == 0:
        return
    price = _LEAST_PRICE
    for i in range(len(slopes)):
        by_p = math.sqrt(slopes[i, P] ** 2 + slopes[i, P + 1] ** 2 + slopes[i, P + 2] ** 2)
        by_v = math.sqrt(slopes[i, V] ** 2 + slopes[i, V + 1] ** 2 + slopes[i, V + 2] ** 2)
        price = max(price, _SLOPE * by_p, _SLOPE * by_v / _SWERVE)
    half_spaces.price[0] = price
    row, slack, state = half_spaces.row, half_spaces.slack, 2 * stages.R.shape[1]
    for i in range(len(slopes)):
        p = kernels.vector(states[i + 1].p_WB)
        for j in range(count):
            n, b = half_spaces.normals[i, j], half_spaces.offsets[i, j]
            kernels.store_vector(kernels.vector(n), stages.normals[i, row + j, state + P :])
            is_free = b >= FREE
            stages.offsets[i, row + j] = FREE if is_free else b - kernels.dot(kernels.vector(n), p)
        stages.linear[i, slack] = price
        stages.quadratic[i, slack] = price * _SQUARE / SLACK_SIZE


@compiled
def farthest_beyond(i: int, half_spaces: HalfSpaces, states: RecordArray[StateRecord]) -> float:
    """Return by how much the end of a stage is beyond the farthest plane, negative inside."""
    p, most = kernels.vector(states[i + 1].p_WB), -FREE
    for j in range(half_spaces.offsets.shape[1]):
        b = half_spaces.offsets[i, j]
        if b < FREE:
            n = kernels.vector(half_spaces.normals[i, j])
            most = max(most, kernels.dot(n, p) - b)
    return most


@compiled
def half_space_penalty(half_spaces: HalfSpaces, states: RecordArray[StateRecord]) -> float:
    """Return what it costs that states 0 to N (N + 1,) are beyond planes.

    It is in the units of the tracking cost, which is twice that of the QP.
    """
    cost, price = 0.0, half_spaces.price[0]
    for i in range(len(half_spaces.offsets)):
        beyond = farthest_beyond(i, half_spaces, states)
        if beyond > 0.0:
            cost += 2.0 * price * beyond * (1.0 + 0.5 * _SQUARE / SLACK_SIZE * beyond)
    return cost

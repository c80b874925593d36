# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Times and misses of the gate passages of a flown path.

A planar gate is passed where the path crosses its plane in the gate's direction, a ball at the
point of the path nearest to its centre. A course may contain a gate several times and a path may
cross a plane elsewhere, so the passages of all gates are chosen together, in the order of the
course: as many as possible through the openings, then as early as possible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.course import Course, Gate

# Costs of a passage outside of the opening, plus its miss [m], and of no passage. They outweigh
# all differences between passages through the opening.
_MAX_MISS = 1e4  # m: larger misses have equal cost
_MISS_COST, _ABSENT_COST = 1e8, 1e8 + 2.0 * _MAX_MISS


@dataclass(frozen=True, kw_only=True)
class Passage:
    """Passage of a gate.

    Attributes:
        time: Time of the passage [s]; None if the path never passes.
        miss: Distance from the centre, in the plane of a planar gate [m].
        passed: Whether the vehicle's centre went through the opening.
        clipped: Whether the edge was nearer than the vehicle's radius, on either side; false for a
            ball.
    """

    time: float | None
    miss: float | None
    passed: bool
    clipped: bool


@dataclass(frozen=True, kw_only=True)
class Lap:
    """The passages of a course in order, and the time at which its end was reached [s] or None.

    The end is reached within its tolerance; without an end, by the passage of the last gate.
    """

    passages: tuple[Passage, ...]
    time: float | None

    @property
    def missed(self) -> int:
        """Number of missed gates."""
        return sum(not passage.passed for passage in self.passages)


@dataclass(frozen=True, kw_only=True, eq=False)
class MovedGates:
    """A course with moving gates: successive ``courses``, and the index of each sample (n,)."""

    courses: Sequence[Course]
    held: NDArray[np.int64]

    def offsets(self, number: int, p_WB: Array) -> tuple[Array, Array]:
        """Return the offsets of a path (n, 3) from a gate before and after each step.

        (n - 1, 3) [m] each, in gate axes, or in world axes for a ball, constant per step.
        """
        gates = [course.gates[number] for course in self.courses]
        held = self.held[:-1]
        p_WG = np.array([gate.p_WG for gate in gates])[held]
        before, after = p_WB[:-1] - p_WG, p_WB[1:] - p_WG
        if gates[0].R_WG is None:
            return before, after
        R_WG = np.array([gate.R_WG for gate in gates])[held]
        return np.einsum("nij,ni->nj", R_WG, before), np.einsum("nij,ni->nj", R_WG, after)


def passages(
    course: Course,
    *,
    seconds: Array,
    p_WB: Array,
    radius: float = 0.0,
    moved: MovedGates | None = None,
) -> Lap:
    """Return the passages of a path, positions (n, 3) [m] at increasing times (n,) [s].

    ``radius`` [m] of the vehicle's bounding sphere defines clipping. ``moved`` has the poses of
    moving gates.
    """
    moved = moved or MovedGates(courses=[course], held=np.zeros(len(seconds), dtype=np.int64))
    found = [
        _nearest(gate, seconds, *moved.offsets(number, p_WB), radius=radius)
        for number, gate in enumerate(course.gates)
    ]
    chosen = _in_order(found)
    after = max((each.time for each in chosen if each.time is not None), default=-math.inf)
    end = course.end
    if end is None:
        last = chosen[-1]
        return Lap(passages=chosen, time=last.time if last.passed else None)
    distance = np.linalg.norm(p_WB - end.p_WB, axis=1)
    reached = np.flatnonzero((distance <= end.tolerance) & (seconds > after))
    if not len(reached):
        return Lap(passages=chosen, time=None)
    span = slice(max(int(reached[0]) - 1, 0), int(reached[0]) + 1)
    time = float(np.interp(-end.tolerance, -distance[span], seconds[span]))
    return Lap(passages=chosen, time=max(time, after))


def _nearest(
    gate: Gate, seconds: Array, before: Array, after: Array, *, radius: float
) -> list[Passage]:
    """Return all passages of a gate, in order of time."""
    p, step = before, after - before
    places: NDArray[np.int64]
    if gate.R_WG is None:
        length = np.sum(step * step, axis=1)
        share = -np.sum(p * step, axis=1) / np.maximum(length, np.finfo(float).tiny)
        share = np.clip(share, 0.0, 1.0)
        offset = p + share[:, None] * step
        miss = np.linalg.norm(offset, axis=1)
        places = _least_of_each_visit(miss, gate.half_width)
    else:
        # The sign after a step must be the sign before the next step.
        places = np.flatnonzero(gate.is_crossed(before[:, 0], after[:, 0]))
        share = np.zeros(len(p))
        share[places] = -before[places, 0] / step[places, 0]
        offset = p + share[:, None] * step
        miss = np.linalg.norm(offset[:, 1:], axis=1)
    times = seconds[:-1] + share * np.diff(seconds)
    room = gate.room(offset)
    return [
        Passage(
            time=float(times[place]),
            miss=float(miss[place]),
            passed=bool(room[place] >= 0.0),
            clipped=gate.R_WG is not None and bool(abs(room[place]) < radius),
        )
        for place in places.tolist()
    ]


def _least_of_each_visit(miss: Array, tolerance: float) -> NDArray[np.int64]:
    """Return local minima of a distance (n,), one per visit inside the tolerance."""
    around = np.pad(miss, 1, constant_values=np.inf)
    least = np.flatnonzero((miss <= around[:-2]) & (miss < around[2:]))
    left = np.cumsum(miss > tolerance)  # constant during a visit
    best: dict[tuple[str, int], int] = {}
    for place in least.tolist():
        inside = miss[place] <= tolerance
        key = ("visit", int(left[place])) if inside else ("outside", place)
        if key not in best or miss[place] < miss[best[key]]:
            best[key] = place
    return np.array(sorted(best.values()), dtype=np.int64)


def _in_order(found: list[list[Passage]]) -> tuple[Passage, ...]:
    """Return one passage of each gate with increasing times at the lowest total cost.

    Dynamic programming over the gates; dominated chains are dropped.
    """
    none = Passage(time=None, miss=None, passed=False, clipped=False)
    chains: list[tuple[float, float, tuple[Passage, ...]]] = [(-math.inf, 0.0, ())]
    for candidates in found:
        longer = [(time, cost + _ABSENT_COST, (*chain, none)) for time, cost, chain in chains]
        for each in candidates:
            assert each.time is not None and each.miss is not None
            before = [entry for entry in chains if entry[0] < each.time]
            if before:
                _, cost, chain = min(before, key=lambda entry: entry[1])
                own = each.time if each.passed else _MISS_COST + min(each.miss, _MAX_MISS)
                longer.append((each.time, cost + own, (*chain, each)))
        chains = []
        for entry in sorted(longer, key=lambda entry: entry[:2]):
            if not chains or entry[1] < chains[-1][1]:
                chains.append(entry)
    return min(chains, key=lambda entry: entry[1])[2]

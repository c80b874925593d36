# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Other vehicles: positions predicted from published plans and odometry, and separation.

Vehicles that share their plans are separated by a plane at each stage. The plane is half way
between the two plans, perpendicular to the line between them but turned about the vertical. Both
vehicles know both plans and turn the plane equally, so each evades to its right, and a symmetric
encounter does not block. Heights have a lower weight in distances because of downwash: ellipsoids
longer in z (Luis, Vukosavljev, Schoellig, "Online trajectory generation with distributed model
predictive control for multi-robot motion planning", RA-L 2020). With n of unit length in scaled
space,

    n' p_i <= n' (p_i + q_i) / 2 - d / 2      n' q_i >= n' (p_i + q_i) / 2 + d / 2

so that the scaled distance is at least d if both vehicles stay on their side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.box import FARTHEST
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.messages.obstacle_messages import TimedPath

_MESSAGE_TIMEOUT_NS = 3_000_000_000  # after the last message
_PLAN_TIMEOUT_NS = 1_000_000_000  # odometry newer than the plan by more: the plan is stale
_MAX_PLAN_DURATION = 10.0  # s of a plan
_ACTIVATION_DISTANCE = 0.4  # m, beyond the distance kept: a plane separates nearer plans
_AVOIDANCE_ANGLE = 0.35  # rad, to the right


class NeighbourPositions(NamedTuple):
    """Positions of a neighbour at n times (n, 3) [m], and the time of reception [ns]."""

    p_W: Array
    received_ns: int


class _State(NamedTuple):
    stamp_ns: int
    p: Array
    v: Array


class Neighbour:
    """Another vehicle, with its odometry and plan.

    The vehicle follows its plan; beyond the plan, or without a plan, its velocity is constant.
    """

    def __init__(self, frame_id: str) -> None:
        self._frame_id = frame_id
        self._plan: TimedPath | None = None
        self._state: _State | None = None

    def receive_odometry(self, odometry: OdometrySample) -> None:
        """Receive the vehicle's odometry. Raises ``ValueError`` if invalid or in another frame."""
        if fault := odometry_fault(odometry, frame_id=self._frame_id):
            raise ValueError(fault)
        velocity = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw) @ odometry.v_WB_B
        self._state = _State(odometry.stamp_ns, odometry.p_WB, velocity)

    def receive_plan(self, path: TimedPath) -> None:
        """Receive the vehicle's plan. Raises ``ValueError`` if invalid or in another frame."""
        times_ns, p = path.times_ns, path.p
        if path.frame_id.lstrip("/") != self._frame_id:
            raise ValueError(f"a plan in '{path.frame_id}', expected '{self._frame_id}'")
        if len(p) < 2 or not (np.abs(p) <= FARTHEST).all():  # NaN compares with nothing
            raise ValueError(f"a plan of {len(p)} positions, expected 2 or more, finite")
        duration = 1e-9 * int(times_ns[-1] - times_ns[0])
        if not (np.diff(times_ns) > 0).all() or duration > _MAX_PLAN_DURATION:
            raise ValueError("a plan whose stamps do not increase, or longer than 10 s")
        self._plan = path

    def at(self, stamps_ns: Sequence[int], *, now_ns: int) -> NeighbourPositions | None:
        """Return the vehicle's predicted positions at times; None without a recent message."""
        plan, state = self._plan, self._state
        stamps = [each.stamp_ns for each in (plan, state) if each is not None]
        received_ns = max(stamps, default=None)
        if received_ns is None or now_ns - received_ns > _MESSAGE_TIMEOUT_NS:
            return None
        times_ns = np.asarray(stamps_ns, dtype=np.int64)
        if plan is not None and received_ns - plan.stamp_ns <= _PLAN_TIMEOUT_NS:
            return NeighbourPositions(_along(plan, times_ns), plan.stamp_ns)
        assert state is not None
        seconds = 1e-9 * (times_ns - state.stamp_ns)
        return NeighbourPositions(state.p + seconds[:, None] * state.v, state.stamp_ns)


def _along(plan: TimedPath, times_ns: NDArray[np.int64]) -> Array:
    """Return positions (n, 3) on a plan, extrapolated with its first and last segment."""
    ends = np.searchsorted(plan.times_ns, times_ns, side="right").clip(1, len(plan.p) - 1)
    first_ns, last_ns = plan.times_ns[ends - 1], plan.times_ns[ends]
    share = (times_ns - first_ns) / (last_ns - first_ns)
    first, last = plan.p[ends - 1], plan.p[ends]
    return np.asarray(first + share[:, None] * (last - first))


class Plans(NamedTuple):
    """Planned positions of m neighbours at n times (m, n, 3) [m], and their ages (m,) [s]."""

    p_W: Array
    age: Array


class Shared(NamedTuple):
    """Half-spaces (n, m, 3) and (n, m) of m neighbours, nearest first."""

    normals: Array
    offsets: Array


def shared_space(
    own_W: Array, plans: Plans, *, keep: Array, heights_count: float
) -> Shared | None:
    """Return half-spaces that separate this vehicle's plan (n, 3) from the neighbours' plans.

    ``keep`` (m,) [m] are the scaled distances to keep, ``heights_count`` the weight of heights.
    None if no plan is near.
    """
    scale = np.array([1.0, 1.0, heights_count])
    away = (plans.p_W - own_W) * scale
    apart = np.linalg.norm(away, axis=2)
    room = (apart - keep[:, None]).min(axis=1, initial=math.inf)
    near = np.flatnonzero(room < _ACTIVATION_DISTANCE)
    if len(near) == 0:
        return None
    near = near[np.argsort(room[near], kind="stable")]
    away, apart = away[near], apart[near]
    beside = np.maximum(apart, 1e-6)[..., None]
    n = np.where(apart[..., None] > 1e-6, away / beside, [1.0, 0.0, 0.0])
    x, y = n[..., 0].copy(), n[..., 1].copy()
    n[..., 0] = math.cos(_AVOIDANCE_ANGLE) * x - math.sin(_AVOIDANCE_ANGLE) * y
    n[..., 1] = math.sin(_AVOIDANCE_ANGLE) * x + math.cos(_AVOIDANCE_ANGLE) * y
    middle = 0.5 * (own_W + plans.p_W[near]) * scale
    offsets = (n * middle).sum(axis=2) - 0.5 * keep[near, None]
    normals = n * scale
    lengths = np.linalg.norm(normals, axis=2)
    return Shared(
        np.swapaxes(normals / lengths[..., None], 0, 1).copy(),
        np.swapaxes(offsets / lengths, 0, 1).copy(),
    )

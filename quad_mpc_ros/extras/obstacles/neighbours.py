"""Other vehicles: their positions predicted from published plans and odometry."""

from __future__ import annotations

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


class NeighbourPositions(NamedTuple):
    """Positions of a neighbour at n times (n, 3) [m], and the time of reception [ns]."""

    p_W: Array
    received_ns: int


class _Plan(NamedTuple):
    times_ns: NDArray[np.int64]
    p: Array
    stamp_ns: int


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
        self._plan: _Plan | None = None
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
        self._plan = _Plan(times_ns, p, path.stamp_ns)

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


def _along(plan: _Plan, times_ns: NDArray[np.int64]) -> Array:
    """Return positions (n, 3) on a plan, extrapolated with its first and last segment."""
    ends = np.searchsorted(plan.times_ns, times_ns, side="right").clip(1, len(plan.p) - 1)
    first_ns, last_ns = plan.times_ns[ends - 1], plan.times_ns[ends]
    share = (times_ns - first_ns) / (last_ns - first_ns)
    first, last = plan.p[ends - 1], plan.p[ends]
    return np.asarray(first + share[:, None] * (last - first))

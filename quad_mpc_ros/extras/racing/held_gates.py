# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Guide that keeps the plan inside gate openings with half-spaces near an edge.

A plan that closely follows a reference through the gates needs no constraint. If the last plan is
nearer to an edge than the margin, or outside, because of a disturbance or a moved gate, the
lateral positions of the stages before and after the passage are constrained. Otherwise there is
no corridor and no additional problem to solve.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.config import GATE_HALF_SPACES
from quad_mpc_ros.control.guide import Guide, Guided
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.references.course import Course, Gate

# m: margin to the edge of an opening, plus the vehicle's radius for a planar gate; at most this
# share of its half size.
_EDGE_MARGIN, _MAX_MARGIN_RATIO = 0.05, 0.8
# m: a plan that passes a gate at a greater distance does not aim at it.
_MAX_MISS = 1.5
# Number of considered next gates.
_GATES_AHEAD = 2
_STAGE_SAMPLES = np.linspace(0.0, 1.0, 9)  # of a stage, to find the passage
_REST_SPEED = 0.1  # m/s
_POLYGON_INRADIUS = math.cos(math.pi / GATE_HALF_SPACES)  # of the polygon inside a circle


class _Crossing(NamedTuple):
    """Passage of a plan: time [s], offset from the centre (3,), lateral axes (3, 2) in W."""

    time: float
    offset_W: Array
    across: Array
    room: float


class HeldGates(Guide):
    """Guide through the gates of a course in order; it restarts when the vehicle is at rest.

    Args:
        course: The gates.
        radius: Radius of the vehicle [m].
    """

    def __init__(self, course: Course, *, radius: float) -> None:
        self._course, self._radius = course, radius
        self._next = 0
        self._before: OdometrySample | None = None

    def move(self, p_WG: Array, q_WG_xyzw: Array) -> None:
        """Receive the poses of the gates; arguments and errors as :meth:`.Course.moved`."""
        self._course = self._course.moved(p_WG, q_WG_xyzw)

    def guide(
        self, odometry: OdometrySample, window: ReferenceWindow, plan: Plan | None
    ) -> Guided:
        """Return the window, and half-spaces if the plan is near the edge of a gate."""
        before, self._before = self._before, odometry
        if before is None or plan is None:
            return Guided(window)
        self._advance(before.p_WB, odometry)
        since = 1e-9 * (odometry.stamp_ns - before.stamp_ns)
        corridor: Corridor | None = None
        for gate in self._course.gates[self._next : self._next + _GATES_AHEAD]:
            passed = _passage(gate, plan)
            if passed is not None and passed.room < self._margin(gate):
                corridor = corridor or _unconstrained_corridor(plan, since)
                self._constrain(gate, passed, plan, since, corridor)
        return Guided(window, corridor)

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Discard the last odometry, which is in the old coordinates."""
        self._before = None

    def _margin(self, gate: Gate) -> float:
        margin = _EDGE_MARGIN if gate.R_WG is None else _EDGE_MARGIN + self._radius
        return min(margin, _MAX_MARGIN_RATIO * min(gate.half_width, gate.half_height))

    def _advance(self, p_before: Array, odometry: OdometrySample) -> None:
        """Advance to the next gate after a passage since the last odometry."""
        if odometry.speed < _REST_SPEED:
            self._next = 0
        for ahead, gate in enumerate(self._course.gates[self._next : self._next + _GATES_AHEAD]):
            if _passes(gate, p_before, odometry):
                self._next += ahead + 1
                return

    def _constrain(
        self, gate: Gate, passed: _Crossing, plan: Plan, since: float, corridor: Corridor
    ) -> None:
        """Write the half-spaces of the stages before and after a passage."""
        margin, sides = self._margin(gate), 4
        angles = np.arange(sides) * 2.0 * math.pi / sides
        half = np.tile([gate.half_width, gate.half_height], 2) - margin
        if gate.is_round:
            sides = GATE_HALF_SPACES
            angles = np.arange(sides) * 2.0 * math.pi / sides
            half = np.full(sides, _POLYGON_INRADIUS * (gate.half_width - margin))
        normals = np.column_stack((np.cos(angles), np.sin(angles))) @ passed.across.T
        left = half - normals @ passed.offset_W
        stage = math.floor((passed.time - since) / plan.step)
        for end in (stage, stage + 1):
            if 1 <= end <= len(corridor.offsets):
                place = _position_at(plan, since + end * plan.step)
                corridor.normals[end - 1, :sides] = normals
                corridor.offsets[end - 1, :sides] = left + normals @ place


class CombinedGuide(Guide):
    """Guide around obstacles and, if the reference is clear, through gates."""

    def __init__(self, around: Guide, gates: HeldGates) -> None:
        self._around, self._gates = around, gates

    def guide(
        self, odometry: OdometrySample, window: ReferenceWindow, plan: Plan | None
    ) -> Guided:
        """Return window and corridor around obstacles, or else through gates.

        An error of the gates does not disable obstacle avoidance.
        """
        through, failure = Guided(window), None
        try:
            through = self._gates.guide(odometry, window, plan)
        except Exception as error:
            failure = error
        around = self._around.guide(odometry, window, plan)
        if failure is not None:
            reason = f"error at the gates: {failure!r}"
            around = around._replace(avoidance=around.avoidance._replace(reason=reason))
        if around.corridor is not None or around.window is not window:
            return around
        return through._replace(avoidance=around.avoidance)


def _unconstrained_corridor(plan: Plan, since: float) -> Corridor:
    """Return a corridor without constraints, ``since`` seconds after the start of a plan."""
    count = len(plan.p_WB) - 1
    return Corridor(
        stamp_ns=plan.stamp_ns + round(1e9 * since),
        step=plan.step,
        normals=np.zeros((count, GATE_HALF_SPACES, 3)),
        offsets=np.full((count, GATE_HALF_SPACES), np.inf),
    )


def _position_at(plan: Plan, time: float) -> Array:
    """Return the position (3,) of a plan at a time from its start, by cubic interpolation."""
    last = len(plan.p_WB) - 1
    first = min(max(math.floor(time / plan.step) - 1, 0), max(last - 3, 0))
    ends = np.arange(first, min(first + 4, last + 1))
    x = min(time / plan.step, float(last))
    weights = [
        math.prod((x - other) / (end - other) for other in ends.tolist() if other != end)
        for end in ends.tolist()
    ]
    return np.asarray(np.array(weights) @ plan.p_WB[ends])


def _passage(gate: Gate, plan: Plan) -> _Crossing | None:
    """Return the first passage of a gate, None if the plan does not pass it."""
    relative = plan.p_WB - gate.p_WG
    if gate.R_WG is None:
        distance = np.linalg.norm(relative, axis=1)
        nearest = int(distance.argmin())
        if not 0 < nearest < len(distance) - 1 or distance[nearest] > _MAX_MISS + gate.half_width:
            return None
        times = plan.step * (nearest - 1.0 + 2.0 * _STAGE_SAMPLES)
        offsets = np.array([_position_at(plan, time) for time in times.tolist()]) - gate.p_WG
        at = int(np.linalg.norm(offsets, axis=1).argmin())
        direction = offsets[min(at + 1, len(offsets) - 1)] - offsets[max(at - 1, 0)]
        across = _across(direction)
        offset_W = across @ (across.T @ offsets[at])  # component across the path
        return _Crossing(times[at], offset_W, across, gate.half_width - math.hypot(*offset_W))
    x = relative @ gate.R_WG[:, 0]
    crossed = np.flatnonzero(gate.is_crossed(x[:-1], x[1:]))
    if not len(crossed):
        return None
    times = plan.step * (crossed[0] + _STAGE_SAMPLES)
    offsets = np.array([_position_at(plan, time) for time in times.tolist()]) - gate.p_WG
    inside = offsets @ gate.R_WG
    at = int(np.abs(inside[:, 0]).argmin())
    if math.hypot(*inside[at, 1:]) > _MAX_MISS + max(gate.half_width, gate.half_height):
        return None
    across = gate.R_WG[:, 1:]
    room = float(gate.room(inside[at : at + 1])[0])
    return _Crossing(times[at], across @ inside[at, 1:], across, room)


def _passes(gate: Gate, p_before: Array, odometry: OdometrySample) -> bool:
    """Return whether the vehicle has passed a gate since its last position."""
    before, after = p_before - gate.p_WG, odometry.p_WB - gate.p_WG
    reach = _MAX_MISS + max(gate.half_width, gate.half_height)
    if min(math.hypot(*before), math.hypot(*after)) > reach:
        return False
    if gate.R_WG is None:
        direction = after - before
        return bool(before @ direction < 0.0 <= after @ direction)
    x_axis = gate.R_WG[:, 0]
    return bool(gate.is_crossed(np.array(before @ x_axis), np.array(after @ x_axis)))


def _across(direction: Array) -> Array:
    """Return two unit vectors (3, 2) perpendicular to a direction (3,)."""
    along = direction / max(float(np.linalg.norm(direction)), 1e-9)
    first = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    first /= np.linalg.norm(first)
    return np.column_stack((first, np.cross(along, first)))

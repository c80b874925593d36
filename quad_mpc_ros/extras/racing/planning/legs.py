# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A course as legs with constraints at their ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.racing.planning.casadi_module import casadi
from quad_mpc_ros.references.course import Course, Finish, Gate

_EDGE_TOLERANCE = 1e-4  # m: a plan at the edge must not be evaluated as outside
_MIN_GATE_SPEED = 1.0  # m/s, least speed through the plane of a gate
GATE_NODE_GAP = 0.03  # m, at least, from a gate's plane to the nodes before and behind it
_ROUTE_WEIGHT, _RUN_OUT_WEIGHT = 1.0, 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Goal:
    """The constraints at the end of a leg.

    ``expressions(p, v)`` (n,) of position and velocity (3,) are between ``lower`` and ``upper``
    (n,). ``depth(p)`` is the distance behind the plane of a gate [m]; None for a ball.
    """

    expressions: Any
    lower: Array
    upper: Array
    depth: Any = None


@dataclass(frozen=True, kw_only=True, eq=False)
class CourseLeg:
    """A leg to a position (3,) [m]: goal, whether the leg ends at rest, and weight of its time.

    A leg without a goal stops the vehicle after a course that ends in flight.
    """

    p_WB: Array
    goal: Goal | None
    at_rest: bool
    weight: float


def legs_of(course: Course, *, margin: float, radius: float) -> list[CourseLeg]:
    """Return the legs of a course.

    ``margin`` [m] is the distance to keep from the edges of gates, plus the vehicle's ``radius``
    [m] for planar gates. Raises :class:`UserError` for an opening that is too small.
    """
    places = course.places()
    legs = []
    for i, gate in enumerate(course.gates):
        kept = _EDGE_TOLERANCE + (margin if gate.R_WG is None else margin + radius)
        half = min(gate.half_width, gate.half_height)
        if half <= kept:
            raise UserError(
                f"{course.source}: gates[{course.numbers[i]}]: unreachable: half of the opening "
                f"is {half:g} m, the margin {kept:.3g} m; lower --gate-margin"
            )
        goal = _gate_goal(gate, margin=kept, direction=places[i + 1] - places[i])
        legs.append(CourseLeg(p_WB=gate.p_WG, goal=goal, at_rest=False, weight=_ROUTE_WEIGHT))
    end = course.end
    if end is not None:
        goal = _end_goal(end)
        legs.append(CourseLeg(p_WB=end.p_WB, goal=goal, at_rest=end.at_rest, weight=_ROUTE_WEIGHT))
    if end is None or not end.at_rest:
        direction = places[-1] - places[-2]
        beyond = places[-1] + 4.0 * direction / np.linalg.norm(direction)
        legs.append(CourseLeg(p_WB=beyond, goal=None, at_rest=True, weight=_RUN_OUT_WEIGHT))
    return legs


def _end_goal(end: Finish) -> Goal:
    if not end.at_rest:
        return _ball(end.p_WB, end.tolerance)
    zero = np.zeros(3)
    return Goal(expressions=lambda p, v: p - end.p_WB, lower=zero, upper=zero)


def _ball(place: Array, radius: float) -> Goal:
    ca = casadi()
    return Goal(
        expressions=lambda p, v: ca.dot(p - place, p - place) / radius,
        lower=np.zeros(1),
        upper=np.array([radius]),
    )


def _gate_goal(gate: Gate, *, margin: float, direction: Array) -> Goal:
    """Return the constraints of a gate that is approached in a ``direction`` (3,)."""
    if gate.R_WG is None:
        return _ball(gate.p_WG, gate.half_width - margin)
    ca = casadi()
    axes, place = ca.DM(gate.R_WG), gate.p_WG
    backward = gate.both_ways and float(direction @ gate.R_WG[:, 0]) < 0.0
    through = -axes[:, 0] if backward else axes[:, 0]
    half_width, half_height = gate.half_width - margin, gate.half_height - margin

    def expressions(p: Any, v: Any) -> Any:
        inside = axes.T @ (p - place)
        speed = ca.dot(through, v)
        if gate.is_round:
            across = (inside[1] ** 2 + inside[2] ** 2) / half_width
            return ca.vertcat(inside[0], across, speed)
        return ca.vertcat(inside, speed)

    across = [half_width] if gate.is_round else [half_width, half_height]
    low = [0.0] if gate.is_round else [-half_width, -half_height]
    return Goal(
        expressions=expressions,
        lower=np.array([0.0, *low, _MIN_GATE_SPEED]),
        upper=np.array([0.0, *across, np.inf]),
        depth=lambda p: ca.dot(through, p - place),
    )

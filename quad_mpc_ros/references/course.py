# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gates and courses: geometry shared by figures and the optional racing."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3

OFF_UNIT = 1e-3
"""Tolerance of the length of a quaternion."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Gate:
    """A gate G: an opening in a plane, or a ball.

    Attributes:
        p_WG: Centre (3,) [m].
        R_WG: Axes of the gate in the world (3, 3): x through it, y across, z up; None for a ball.
        half_width: Half of the opening along y [m]; the radius of a round gate.
        half_height: Half of the opening along z [m]; the radius of a round gate.
        is_round: Whether the gate is a circle or a ball.
        both_ways: Whether the gate can also be passed against x.
    """

    p_WG: Array
    R_WG: Array | None
    half_width: float
    half_height: float
    is_round: bool
    both_ways: bool = False

    def room(self, offset: Array) -> Array:
        """Return the distance (n,) [m] of points in the gate to its edge, negative outside.

        ``offset`` (n, 3) [m] is from the centre, in the gate's axes, or in world axes for a ball.
        """
        if self.is_round:
            across = offset if self.R_WG is None else offset[:, 1:]
            return np.asarray(self.half_width - np.linalg.norm(across, axis=1))
        left = np.array([self.half_width, self.half_height]) - np.abs(offset[:, 1:])
        outside = np.linalg.norm(np.minimum(left, 0.0), axis=1)
        return np.asarray(np.where(outside > 0.0, -outside, left.min(axis=1)))

    def is_crossed(self, x: Array, x_after: Array) -> Array:
        """Return whether steps (n,) cross the plane of the gate in a permitted direction.

        ``x`` and ``x_after`` (n,) [m] are along the gate's x axis, before and after each step.
        """
        forward, backward = (x < 0.0) & (x_after >= 0.0), (x > 0.0) & (x_after <= 0.0)
        return np.asarray(forward | backward if self.both_ways else forward)

    def corners(self) -> Array:
        """Return the corners (n, 3) [m] of the opening in order, or points on a circle.

        A ball has three circles, one after the other.
        """
        turn = np.linspace(0.0, 2.0 * math.pi, 33)
        circle = self.half_width * np.column_stack((0.0 * turn, np.cos(turn), np.sin(turn)))
        if self.R_WG is None:
            rings = np.vstack([np.roll(circle, shift, axis=1) for shift in range(3)])
            return np.asarray(self.p_WG + rings)
        if not self.is_round:
            ends = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1)], dtype=np.float64)
            sides = ends * [self.half_width, self.half_height]
            circle = np.column_stack((np.zeros(len(ends)), sides))
        return np.asarray(self.p_WG + circle @ self.R_WG.T)


@dataclass(frozen=True, kw_only=True, eq=False)
class Finish:
    """End of a course (3,) [m], its tolerance [m], and whether the vehicle must be at rest."""

    p_WB: Array
    tolerance: float
    at_rest: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Course:
    """Gates in the order in which they are passed, all laps, from a start at rest to an end.

    At ``start`` (3,) [m] the vehicle is level, with heading ``start_yaw`` [rad] from east. Without
    an ``end`` the last gate is the end. ``numbers`` count the gates in the file, from 1.
    """

    source: str
    start: Array
    start_yaw: float
    gates: tuple[Gate, ...]
    numbers: tuple[int, ...]
    end: Finish | None

    def places(self) -> Array:
        """Return the start, the centre of each gate, and the end if there is one (n, 3) [m]."""
        rows = [self.start, *(gate.p_WG for gate in self.gates)]
        return np.array(rows if self.end is None else [*rows, self.end.p_WB])

    def once(self) -> dict[int, Gate]:
        """Return each passed gate by its number, for drawing."""
        return dict(sorted(dict(zip(self.numbers, self.gates, strict=True)).items()))

    def moved(self, p_WG: Array, q_WG_xyzw: Array) -> Course:
        """Return the course with the current poses of the gates, in the order of the file.

        Centres (n, 3) [m] and quaternions (n, 4), unused for balls. Raises :class:`UserError` for
        fewer gates than the course has, and for invalid poses.
        """
        count = max(self.numbers)
        if len(p_WG) < count:
            raise UserError(f"gates: given {len(p_WG)} poses, expected one per gate, {count}")
        moved = {}
        for number, gate in self.once().items():
            p, q = p_WG[number - 1], q_WG_xyzw[number - 1]
            off_unit = 0.0 if gate.R_WG is None else abs(float(np.linalg.norm(q)) - 1.0)
            if not (np.isfinite(p).all() and off_unit < OFF_UNIT):
                raise UserError(
                    f"gates: gate {number} at {p.tolist()} with the quaternion {q.tolist()}, "
                    "expected finite numbers and a unit quaternion"
                )
            R_WG = None if gate.R_WG is None else so3.rotation_from_quaternion_xyzw(q)
            moved[number] = dataclasses.replace(gate, p_WG=p, R_WG=R_WG)
        return dataclasses.replace(self, gates=tuple(moved[number] for number in self.numbers))

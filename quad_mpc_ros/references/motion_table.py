# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Complete motions: position, velocity, acceleration, attitude and body rates over time.

Optimised motions are flown unchanged, not by flatness from a smoothed path, because they are at
bounds of thrust or body rates. A file is a ``csv`` with these columns in addition to time and
position; see :mod:`quad_mpc_ros.references.point_table`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.trajectory import TrajectorySamples, combined, resting

if TYPE_CHECKING:
    from scipy.interpolate import BPoly

MOTION_UNITS = {
    **dict.fromkeys(("vx", "vy", "vz"), "m/s"),
    **dict.fromkeys(("ax", "ay", "az"), "m/s^2"),
    **dict.fromkeys(("qx", "qy", "qz", "qw"), "1"),
    **dict.fromkeys(("wx", "wy", "wz"), "rad/s"),
}
"""The columns of a motion and their units: velocity and acceleration in the world, the attitude
of the body in the world, the body rates in the body."""
_POSITION_UNITS = {"time": "s", "x": "m", "y": "m", "z": "m"}
_AT_REST = 0.05  # m/s
_OFF_UNIT = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionTable:
    """A motion at n times, n > 1, increasing; ``source`` is its origin, for errors.

    Shapes: ``seconds`` (n,) [s]; ``p_WB``, ``v_WB_W``, ``a_WB_W``, ``w_WB_B`` (n, 3);
    ``q_WB_xyzw`` (n, 4). The motion starts and ends at rest.
    """

    source: str
    seconds: Array
    p_WB: Array
    v_WB_W: Array
    a_WB_W: Array
    q_WB_xyzw: Array
    w_WB_B: Array

    def __post_init__(self) -> None:
        """Raise :class:`UserError` for an end in motion and for an invalid attitude."""
        for name, place in (("first", 0), ("last", -1)):
            speed = float(np.linalg.norm(self.v_WB_W[place]))
            if not speed < _AT_REST:
                raise UserError(
                    f"{self.source}: the {name} row moves at {speed:.3g} m/s, expected a motion "
                    "that starts and ends at rest"
                )
        lengths = np.linalg.norm(self.q_WB_xyzw, axis=1)
        for row in np.flatnonzero(~(np.abs(lengths - 1.0) < _OFF_UNIT))[:1]:
            raise UserError(
                f"{self.source}: row {row} (counted from 0) has a quaternion of length "
                f"{lengths[row]:.4g}, expected 1"
            )

    def text(self) -> str:
        """Return the table as a file."""
        units = {**_POSITION_UNITS, **MOTION_UNITS}
        rows = np.column_stack(
            (
                *(self.seconds, self.p_WB, self.v_WB_W, self.a_WB_W),
                *(self.q_WB_xyzw, self.w_WB_B),
            )
        )
        lines = [", ".join(f"{name} [{unit}]" for name, unit in units.items())]
        lines += [", ".join(f"{value:.9f}" for value in row) for row in rows.tolist()]
        return "\n".join(lines) + "\n"


class PlannedMotion:
    """A motion table as a trajectory; before it and after it the vehicle rests at its ends.

    Between rows the position is a polynomial of degree 5, acceleration and body rates are linear,
    and the attitude rotates at a constant rate.
    """

    smooth = True
    fixed = True

    def __init__(self, table: MotionTable, *, offset: Array | None = None) -> None:
        """Take a table, displaced by ``offset`` (3,) [m]."""
        from scipy.interpolate import BPoly

        if offset is not None:
            table = dataclasses.replace(table, p_WB=table.p_WB + offset)
        self.table = table
        """The displaced table."""
        self._seconds = table.seconds - table.seconds[0]
        given = np.stack((table.p_WB, table.v_WB_W, table.a_WB_W), axis=1)
        self._p: BPoly = BPoly.from_derivatives(self._seconds, given)
        self._v: BPoly = self._p.derivative()
        self._R = so3.rotation_from_quaternion_xyzw(
            table.q_WB_xyzw / np.linalg.norm(table.q_WB_xyzw, axis=1, keepdims=True)
        )
        self._turns = so3.log(np.swapaxes(self._R[:-1], -1, -2) @ self._R[1:])

    @property
    def period_ns(self) -> int:
        """The duration of the motion."""
        return round(1e9 * float(self._seconds[-1]))

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the samples at these times."""
        seconds = 1e-9 * np.array(times_ns, dtype=np.float64)
        end = float(self._seconds[-1])
        moving = self._moving(np.clip(seconds, 0.0, end))
        rests = (seconds < 0.0) | (seconds >= end)
        if not rests.any():
            return moving
        return combined(lambda *each: np.where(rests[:, None], *each), resting(moving), moving)

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return none."""
        return []

    def _moving(self, seconds: Array) -> TrajectorySamples:
        table, knots = self.table, self._seconds
        row = np.clip(np.searchsorted(knots, seconds, side="right") - 1, 0, len(knots) - 2)
        share = ((seconds - knots[row]) / (knots[row + 1] - knots[row]))[:, None]
        R_WB = self._R[row] @ so3.exp(share * self._turns[row])
        w_WB_B = (1.0 - share) * table.w_WB_B[row] + share * table.w_WB_B[row + 1]
        return TrajectorySamples(
            p_WB=np.asarray(self._p(seconds)),
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
            v_WB_W=np.asarray(self._v(seconds)),
            a_WB_W=(1.0 - share) * table.a_WB_W[row] + share * table.a_WB_W[row + 1],
            w_WB_W=np.einsum("nij,nj->ni", R_WB, w_WB_B),
        )

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""An announced jump of the odometry frame: the vehicle stays, its coordinates change."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration.arguments import array, instance, number, stamp
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.lie.formulas import heading
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimateReset:
    """Transform of positions p in the world frame to Rz(turn) p + step_W.

    Args:
        stamp_ns: Stamp of the first odometry in the new coordinates [ns].
        turn: Rotation about the vertical, from east to north [rad].
        step_W: Position of the old origin in the new coordinates (3,) [m].
        frame_id: The world frame.
    """

    stamp_ns: int
    turn: float
    step_W: Array
    frame_id: str = "odom"

    def __post_init__(self) -> None:
        object.__setattr__(self, "stamp_ns", stamp(self.stamp_ns, "stamp_ns"))
        object.__setattr__(self, "turn", number(self.turn, "turn"))
        object.__setattr__(self, "step_W", array(self.step_W, "step_W", 3, finite=True))
        instance(self.frame_id, "frame_id", str)

    @classmethod
    def between(cls, before: OdometrySample, after: OdometrySample) -> EstimateReset:
        """Return the jump between two odometries without the predicted motion of the vehicle."""
        duration = 1e-9 * (after.stamp_ns - before.stamp_ns)
        R_WB = so3.rotation_from_quaternion_xyzw(before.q_WB_xyzw)
        expected = so3.quaternion_xyzw_from_rotation(R_WB @ so3.exp(duration * before.w_WB_B))
        stepped = heading(after.q_WB_xyzw.tolist()) - heading(expected.tolist())
        turn = math.remainder(stepped, math.tau)
        p = before.p_WB + duration * (R_WB @ before.v_WB_B)
        step_W = after.p_WB - _rotation(turn) @ p
        return cls(stamp_ns=after.stamp_ns, turn=turn, step_W=step_W, frame_id=after.frame_id)

    def vectors(self, v_W: Array) -> Array:
        """Return vectors of the world (..., 3) in the new coordinates."""
        return np.asarray(v_W @ _rotation(self.turn).T)

    def points(self, p_W: Array) -> Array:
        """Return points (..., 3) [m] in the new coordinates."""
        return self.vectors(p_W) + self.step_W

    def attitudes(self, q_WB_xyzw: Array) -> Array:
        """Return attitudes (..., 4), body to world, in the new coordinates."""
        R_WB = so3.rotation_from_quaternion_xyzw(q_WB_xyzw)
        return np.asarray(so3.quaternion_xyzw_from_rotation(_rotation(self.turn) @ R_WB))

    def odometry(self, odometry: OdometrySample) -> OdometrySample:
        """Return an odometry, with its twist in the body frame, in the new coordinates."""
        return dataclasses.replace(
            odometry,
            p_WB=self.points(odometry.p_WB),
            q_WB_xyzw=self.attitudes(odometry.q_WB_xyzw),
        )

    def window(self, window: ReferenceWindow) -> ReferenceWindow:
        """Return a reference in the new coordinates."""
        moved: dict[str, Any] = self.samples(window)
        return dataclasses.replace(window, **moved)

    def corridor(self, corridor: Corridor) -> Corridor:
        """Return a corridor in the new coordinates."""
        normals = self.vectors(corridor.normals)
        offsets = corridor.offsets + normals @ self.step_W
        return dataclasses.replace(corridor, normals=normals, offsets=offsets)

    def samples(self, samples: Any) -> dict[str, Array]:
        """Return fields of a reference's samples in the new coordinates, by name.

        Fields: ``p_WB``, ``v_WB_W``, ``a_WB_W``, ``w_WB_W`` (n, 3) and ``q_WB_xyzw`` (n, 4).
        """
        moved = {name: self.vectors(getattr(samples, name)) for name in _VECTORS}
        return {
            "p_WB": self.points(samples.p_WB),
            "q_WB_xyzw": self.attitudes(samples.q_WB_xyzw),
            **moved,
        }


_VECTORS = ("v_WB_W", "a_WB_W", "w_WB_W")


def _rotation(turn: float) -> Array:
    return np.asarray(so3.exp([0.0, 0.0, turn]))

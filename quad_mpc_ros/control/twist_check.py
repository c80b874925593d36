"""Does the odometry's velocity agree with its own positions, or is it in the other frame?"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.core import so3
from quad_mpc_ros.core.messages import Array, OdometrySample

_SPEED_ENOUGH = 0.5  # m/s, below it noise hides the frame
_EVIDENCE_NEEDED = 25  # samples in disfavour more than in favour


class TwistFrameCheck:
    """Collects evidence that the twist is given in the frame it is not configured for.

    Each pair of odometries moving at speed votes: the displacement is compared with the velocity
    read as body frame and read as world frame.
    """

    def __init__(self, *, twist_frame: str) -> None:
        self._twist_frame = twist_frame
        self._previous: OdometrySample | None = None
        self._evidence = 0
        self._told = False

    def suspect(self, odometry: OdometrySample) -> str | None:
        """Return the frame the twist really seems to be in, once, when the evidence is enough."""
        previous, self._previous = self._previous, odometry
        if previous is None or odometry.stamp_ns <= previous.stamp_ns:
            return None
        measured = (odometry.p_WB - previous.p_WB) / (
            (odometry.stamp_ns - previous.stamp_ns) * 1e-9
        )
        R_WB = so3.rotation_from_quaternion_xyzw(previous.q_WB_xyzw)
        as_child = _distance(measured, R_WB @ previous.v_WB_B)
        as_world = _distance(measured, previous.v_WB_B)
        if _distance(measured, np.zeros(3)) < _SPEED_ENOUGH:
            return None
        configured, other = (
            (as_child, as_world) if self._twist_frame == "child" else (as_world, as_child)
        )
        if abs(configured - other) > 0.5 * _SPEED_ENOUGH:
            self._evidence = max(self._evidence + (1 if configured > other else -1), 0)
        if self._told or self._evidence < _EVIDENCE_NEEDED:
            return None
        self._told = True
        return "world" if self._twist_frame == "child" else "child"


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b))

"""Does the odometry's velocity agree with its own positions, or is it in the other frame?"""

from __future__ import annotations

from collections import deque

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.stage import Stage

_SPEED_ENOUGH = 0.5  # m/s, below it noise hides the frame
_MOST_UNCHECKED = 100
_EVIDENCE_NEEDED = 25  # samples in disfavour more than in favour


class TwistFrameCheck(Stage):
    """Collects evidence that the twist is given in the frame it is not configured for.

    Each pair of odometries moving at speed votes: the displacement is compared with the velocity
    read as body frame and read as world frame.
    """

    def __init__(self, *, twist_frame: str) -> None:
        self._twist_frame = twist_frame
        # Bounded, for a verdict may never be asked for.
        self._unchecked: deque[OdometrySample] = deque(maxlen=_MOST_UNCHECKED)
        self._previous: OdometrySample | None = None
        self._evidence = 0
        self._reported = False

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Forget the odometries in the coordinates before; the evidence stays."""
        self._unchecked.clear()
        self._previous = None

    def note(self, odometry: OdometrySample) -> None:
        """Keep an odometry until there is time to look at it: once the command is out."""
        self._unchecked.append(odometry)

    def verdict(self) -> str | None:
        """Look at all that was noted; return the frame the twist really seems to be in, once."""
        found = [frame for frame in map(self.suspect, self._unchecked) if frame is not None]
        self._unchecked.clear()
        return found[0] if found else None

    def suspect(self, odometry: OdometrySample) -> str | None:
        """Return the frame the twist really seems to be in, once, when the evidence is enough."""
        previous, self._previous = self._previous, odometry
        if previous is None or odometry.stamp_ns <= previous.stamp_ns:
            return None
        speed, as_child, as_world = _disagreement(
            previous.p_WB,
            odometry.p_WB,
            previous.q_WB_xyzw,
            previous.v_WB_B,
            1e-9 * (odometry.stamp_ns - previous.stamp_ns),
        )
        if speed < _SPEED_ENOUGH:
            return None
        configured, other = (
            (as_child, as_world) if self._twist_frame == "child" else (as_world, as_child)
        )
        if abs(configured - other) > 0.5 * _SPEED_ENOUGH:
            self._evidence = max(self._evidence + (1 if configured > other else -1), 0)
        if self._reported or self._evidence < _EVIDENCE_NEEDED:
            return None
        self._reported = True
        return "world" if self._twist_frame == "child" else "child"


@compiled
def _disagreement(
    p_before: Array, p_after: Array, q_WB_xyzw: Array, v: Array, duration: float
) -> tuple[float, float, float]:
    """Return the speed between two positions, and how far the twist is off if body or world."""
    moved = kernels.minus(kernels.vector(p_after), kernels.vector(p_before))
    measured = kernels.scaled(1.0 / duration, moved)
    child, world = kernels.in_world(q_WB_xyzw, v), kernels.vector(v)
    return (
        kernels.norm(measured),
        kernels.norm(kernels.minus(measured, child)),
        kernels.norm(kernels.minus(measured, world)),
    )

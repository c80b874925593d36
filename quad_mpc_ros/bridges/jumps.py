"""Steps in the estimated position, which the MPC flies on from."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.lie import Array
from quad_mpc_ros.model.samples import OdometrySample
from quad_mpc_ros.model.state import state_from_odometry

_STEP = 0.5  # m, beyond what the velocity explains
_LONGEST_GAP_NS = 1_000_000_000


class PositionJumps:
    """Counts the steps. They are told, not hidden: the odometry is passed on as it is."""

    def __init__(self) -> None:
        self.count = 0
        self._before: OdometrySample | None = None
        self._v_WB_W: Array = np.zeros(3)

    def check(self, odometry: OdometrySample, *, cause: str | None) -> str | None:
        """Return what to tell of an odometry; ``cause`` is what the stack said of a reset."""
        before, v_before = self._before, self._v_WB_W
        self._before, self._v_WB_W = odometry, state_from_odometry(odometry).v_WB_W
        if before is None:
            return None
        gap_ns = odometry.stamp_ns - before.stamp_ns
        mean_velocity = 0.5 * (v_before + self._v_WB_W)
        step = float(np.linalg.norm(odometry.p_WB - before.p_WB - 1e-9 * gap_ns * mean_velocity))
        if cause is None and not (0 < gap_ns < _LONGEST_GAP_NS and step > _STEP):
            return None
        self.count += 1
        return f"the estimate steps by {step:.2f} m ({cause or 'no reset was announced'})"

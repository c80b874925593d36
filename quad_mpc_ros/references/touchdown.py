"""Whether a landing vehicle has reached the ground: it stays although it should sink.

Commands are not known here (``control/estimation/ground.py`` compares the judges of the ground).
"""

from __future__ import annotations

from collections import deque

import numpy as np

from quad_mpc_ros.control.estimation.ground import SINKING_IN_VAIN
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample

_DURATION_NS = 500_000_000
_LEAST_SAMPLES = 5
# Shares of the touchdown speed that count as still: measured, and by the change of height.
_SLOW, _STILL = 0.5, 1.0 / 3.0


class Touchdown:
    """Watches one landing.

    For half a second the reference must be below the vehicle, and both the velocities and the
    heights of its odometry, averaged because of their noise, must show that it stays.
    """

    def __init__(self, touchdown_speed: float) -> None:
        self._speed = touchdown_speed
        self._kept: deque[tuple[int, float, Array]] = deque()

    def felt(self, odometry: OdometrySample, *, reference_height: float) -> bool:
        """Take the next odometry; return whether the ground carries the vehicle."""
        height = float(odometry.p_WB[2])
        if not height - reference_height > SINKING_IN_VAIN:
            self._kept.clear()
            return False
        self._kept.append((odometry.stamp_ns, height, odometry.v_WB_B))
        if odometry.stamp_ns - self._kept[0][0] < _DURATION_NS:
            return False
        stays = len(self._kept) >= _LEAST_SAMPLES and self._stays()
        self._kept.popleft()
        return stays

    def _stays(self) -> bool:
        stamps, heights, velocities = (
            np.array(values) for values in zip(*self._kept, strict=True)
        )
        seconds = 1e-9 * (stamps - stamps[0])
        seconds = seconds - seconds.mean()
        climb = float(seconds @ heights / (seconds @ seconds))
        speed = float(np.linalg.norm(velocities.mean(axis=0)))
        return abs(climb) < _STILL * self._speed and speed < _SLOW * self._speed

"""Whether a landing vehicle has reached the ground: it stays although it should sink.

The rule of a reference that hears neither the MPC's ``mpc/ground_state`` nor a flight stack; it
knows no commands.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from quad_mpc_ros.control.estimation.ground_state import LEFT_GROUND
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample

_DURATION_NS = 500_000_000
_STILL = 0.5  # share of the touchdown speed


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
        if not height - reference_height > LEFT_GROUND:
            self._kept.clear()
            return False
        self._kept.append((odometry.stamp_ns, height, odometry.v_WB_B))
        if odometry.stamp_ns - self._kept[0][0] < _DURATION_NS:
            return False
        stays = self._stays()
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
        return max(abs(climb), speed) < _STILL * self._speed

"""One point above the origin, held at a heading."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.trajectories.trajectory import (
    TrajectoryParameters,
    TrajectorySamples,
    at_rest,
)


class Hover:
    """The point, for ever."""

    smooth = True
    period_ns = 0

    def __init__(self, config: TrajectoryParameters) -> None:
        self._p_WB = np.array([*config.origin, config.height])
        self._yaw = config.yaw

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the point, once for each time."""
        return at_rest(np.tile(self._p_WB, (len(times_ns), 1)), yaw=self._yaw)

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return nothing: it never moves."""
        return []

    def before(self, time_ns: int) -> TrajectorySamples:
        """Return the point."""
        return self.at([time_ns])

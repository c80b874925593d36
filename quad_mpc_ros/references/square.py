"""The paper's reference (section 2.2): a square of waypoints, each held for a while.

Not feasible, as it jumps between the corners, and so a test of the controller rather than of the
reference. The corners in order, from the origin: east, north, west, and back; heading east
throughout.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.trajectory import TrajectorySamples, at_rest


class Square:
    """Piecewise constant waypoints, round and round."""

    smooth = False

    def __init__(self, config: ReferenceConfig) -> None:
        s, h = config.side, config.height
        corners = np.array([[0.0, 0.0, h], [s, 0.0, h], [s, s, h], [0.0, s, h]])
        self._corners = corners + np.array([*config.origin, 0.0])
        self._dwell_ns = round(config.dwell_time * 1e9)

    @property
    def period_ns(self) -> int:
        """One round."""
        return len(self._corners) * self._dwell_ns

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the corners held at these times; the first one before the start."""
        legs = [max(time // self._dwell_ns, 0) % len(self._corners) for time in times_ns]
        return at_rest(self._corners[legs])

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the switches between corners in (start, end]."""
        first = max(start_ns // self._dwell_ns + 1, 1)
        last = end_ns // self._dwell_ns
        return [leg * self._dwell_ns for leg in range(first, last + 1)]

    def before(self, time_ns: int) -> TrajectorySamples:
        """Return the corner held just before a time."""
        return self.at([time_ns - 1])

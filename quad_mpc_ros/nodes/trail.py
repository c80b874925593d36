"""The path flown of late."""

from __future__ import annotations

from collections import deque

import numpy as np

from quad_mpc_ros.lie import Array


class Trail:
    """Positions of the last ``duration`` [s], at least ``spacing`` [s] apart."""

    def __init__(self, *, duration: float, spacing: float) -> None:
        self._duration_ns, self._spacing_ns = round(duration * 1e9), round(spacing * 1e9)
        self._places: deque[tuple[int, Array]] = deque()

    def add(self, stamp_ns: int, p_WB: Array) -> None:
        """Take a position (3,) [m]; a stamp that runs backwards begins a new trail."""
        if self._places and stamp_ns < self._places[-1][0]:
            self._places.clear()
        if not self._places or stamp_ns - self._places[-1][0] >= self._spacing_ns:
            self._places.append((stamp_ns, p_WB))
        while stamp_ns - self._places[0][0] > self._duration_ns:
            self._places.popleft()

    @property
    def p_WB(self) -> Array:
        """Positions (n, 3) [m], the oldest first."""
        return np.array([p_WB for _, p_WB in self._places]).reshape(-1, 3)

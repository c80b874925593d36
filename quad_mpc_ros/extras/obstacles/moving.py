# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Moving balls, predicted with constant velocity: collisions and half-spaces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array


class MovingPoints(NamedTuple):
    """Points on moving surfaces: ``p_W`` (n, 3) [m] at the requested time, ``v_W`` [m/s].

    ``body`` (n,) is the number of the body, which is passed on one side; ``age`` (n,) [s] is the
    age of the last message.
    """

    p_W: Array
    v_W: Array
    body: NDArray[np.int64]
    age: Array

    @staticmethod
    def none() -> MovingPoints:
        """Return no points."""
        empty = np.zeros((0, 3))
        return MovingPoints(empty, empty, np.zeros(0, np.int64), np.zeros(0))


class Movers(NamedTuple):
    """Moving balls: ``p_W`` (m, 3) now, ``v_W`` (m, 3), and the distance to keep from each.

    The distance is ``keep`` (m,) [m] now and increases by ``growth`` [m/s]. Balls of the same
    ``body`` (m,) are passed on one side.
    """

    p_W: Array
    v_W: Array
    keep: Array
    growth: float
    body: NDArray[np.int64]

    @staticmethod
    def none() -> Movers:
        """Return no balls."""
        empty = np.zeros((0, 3))
        return Movers(empty, empty, np.zeros(0), 0.0, np.zeros(0, np.int64))

    def after(self, time: float) -> Movers:
        """Return the balls a time [s] later."""
        later = self.keep + self.growth * time
        return self._replace(p_W=self.p_W + time * self.v_W, keep=later)

    def clearance(self, times: Array, places: Array) -> Array:
        """Return the distances beyond ``keep`` of positions (n, 3) at times (n,) [s].

        Shape (n, m), negative if a ball is too near.
        """
        away = self._at(times) - places[:, None]
        kept = self.keep + self.growth * times[:, None]
        return np.asarray(np.linalg.norm(away, axis=2) - kept)

    def meet(self, times: Array, places: Array) -> bool:
        """Return whether a ball is too near to positions (n, 3) at times (n,) [s] from now."""
        return len(self.keep) > 0 and bool((self.clearance(times, places) < 0.0).any())

    def write_half_spaces(
        self, times: Array, places: Array, *, normals: Array, offsets: Array
    ) -> int:
        """Write a half-space for each body, nearest first, and return their number.

        At each time (n,) the plane touches the body's ball nearest to the guide's position (n, 3):
        ``normals`` (n, K, 3), ``offsets`` (n, K). At most half of the K rows are written.
        """
        if len(self.keep) == 0:
            return 0
        at, clearance = self._at(times), self.clearance(times, places)
        bodies = np.unique(self.body).tolist()
        nearest = sorted(bodies, key=lambda body: float(clearance[:, self.body == body].min()))
        rows: int = min(len(bodies), (offsets.shape[1] + 1) // 2)
        stages = np.arange(len(times))
        for row, body in enumerate(nearest[:rows]):
            own = np.flatnonzero(self.body == body)
            ball = own[clearance[:, own].argmin(axis=1)]
            away = at[stages, ball] - places
            n = away / np.maximum(np.linalg.norm(away, axis=1), 1e-6)[:, None]
            normals[:, row] = n
            kept = self.keep[ball] + self.growth * times
            offsets[:, row] = (n * at[stages, ball]).sum(axis=1) - kept
        return rows

    def _at(self, times: Array) -> Array:
        """Return the positions (n, m, 3) at times (n,)."""
        return np.asarray(self.p_W + times[:, None, None] * self.v_W)

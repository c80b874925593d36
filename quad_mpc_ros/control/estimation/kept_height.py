# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Detection of a height that a vehicle in the air could not hold: it is on the ground.

A body with an acceleration of at least a covers at least a T^2 / 8 of height in a time T, the
least around the highest point of a ballistic arc. A vehicle on the ground covers at most half of
this height. Heights are compared because speeds are noisier.
"""

from __future__ import annotations

THRUST_ERROR = 0.5
"""Largest relative error of the modelled thrust."""
GUST = 0.2
"""Largest acceleration by gusts, as a share of gravity."""
SETTLING = 0.2
"""Time [s] from a reduction of the throttle to the loss of lift."""


class KeptHeight:
    """Tracks how long a vehicle has held a height that it could not hold in the air."""

    def __init__(self, shortest: float) -> None:
        """Compare over one to two times ``shortest`` [s], then restart."""
        self._shortest = shortest
        self._since_ns: int | None = None
        self._lowest = self._highest = self._least = 0.0

    def forget(self) -> None:
        """Restart at the next height."""
        self._since_ns = None

    def lasts(self, stamp_ns: int, height: float, acceleration: float) -> bool:
        """Take a height [m]; return whether the height has been held long enough.

        ``acceleration`` [m/s^2] is the least possible acceleration in the air, or 0.
        """
        if acceleration <= 0.0:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = stamp_ns
            self._lowest, self._highest, self._least = height, height, acceleration
        self._lowest, self._highest = min(self._lowest, height), max(self._highest, height)
        self._least = min(self._least, acceleration)
        duration = 1e-9 * (stamp_ns - self._since_ns)
        covered = self._highest - self._lowest
        kept = duration >= self._shortest and covered < 0.5 * self._least * duration**2 / 8.0
        if duration > 2.0 * self._shortest:
            self.forget()
        return kept


def since(since_ns: int | None, now_ns: int) -> int:
    """Return the start time of a condition that is true, ``since_ns`` or now."""
    return now_ns if since_ns is None else since_ns

"""Detection of a height that a vehicle in the air could not keep, so that the ground carries it.

A body with an acceleration of at least a covers at least a T^2 / 8 of height in a time T, namely
about the turning point of a throw. A vehicle on the ground covers at most half of that. Heights
are compared because speeds are noisier.
"""

from __future__ import annotations

THRUST_ERROR = 0.5
"""Largest relative error of the modelled thrust."""
GUST = 0.2
"""Largest acceleration by gusts, as a share of gravity."""
SETTLING = 0.2
"""Time [s] after which motors no longer lift once the throttle is reduced."""


class KeptHeight:
    """Tracks how long a vehicle has kept its height although in the air it could not."""

    def __init__(self, shortest: float) -> None:
        """Compare over ``shortest`` [s] to twice that, then restart."""
        self._shortest = shortest
        self._since_ns: int | None = None
        self._lowest = self._highest = self._least = 0.0

    def forget(self) -> None:
        """Restart at the next height."""
        self._since_ns = None

    def lasts(self, stamp_ns: int, height: float, acceleration: float) -> bool:
        """Take a height [m]; return whether it has been kept long enough.

        ``acceleration`` [m/s^2] is the least possible one in the air, 0 if it may be none.
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

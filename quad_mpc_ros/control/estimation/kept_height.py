"""What keeps a height that nothing in the air could keep: the argument that something carries it.

Whatever has an acceleration of at least a covers over a time T at least a T^2 / 8 of height, at
the turning point of a throw, which is the least. Half of that is the most that what stands or lies
may cover. Heights are compared and not speeds, whose noise would look like motion: where speeds
are noisy, positions are smooth.
"""

from __future__ import annotations

THRUST_ERROR = 0.5
"""By how much the true thrust may be more or less than the modelled, as a share of that."""
GUST = 0.2
"""Acceleration that air may push with, as a share of gravity."""
SETTLING = 0.2
"""Time [s] after which a throttle that was given up no longer lifts."""


class KeptHeight:
    """For how long a vehicle has kept its height although in the air it could not."""

    def __init__(self, shortest: float) -> None:
        """Take the shortest time T [s]; the longest is twice that, and then it restarts."""
        self._shortest = shortest
        self._since_ns: int | None = None
        self._lowest = self._highest = self._least = 0.0

    def forget(self) -> None:
        """Restart at the next height."""
        self._since_ns = None

    def lasts(self, stamp_ns: int, height: float, acceleration: float) -> bool:
        """Take a height [m]; return whether it has been kept for long enough.

        ``acceleration`` [m/s^2] is the least that it has in the air, 0 where it may have none.
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

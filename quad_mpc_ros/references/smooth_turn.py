"""A smooth turn from rest to rest: an angle over time.

The rate is proportional to (1 - u^4)^3 for u from -1 to 1: flat in the middle, where it is 1.52
times the mean, and zero with its first two derivatives at both ends.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from quad_mpc_ros.control.lie import Array

_RATE_SHAPE = Polynomial([1.0, 0.0, 0.0, 0.0, -1.0]) ** 3
_ANGLE_SHAPE = _RATE_SHAPE.integ(lbnd=-1.0)
# The completed share of the turn at u, and its derivatives.
_SHARES = [
    _ANGLE_SHAPE / _ANGLE_SHAPE(1.0),
    *((_RATE_SHAPE / _ANGLE_SHAPE(1.0)).deriv(order) for order in range(3)),
]

PEAK = float(2.0 * _SHARES[1](0.0))
"""Ratio of the highest to the mean rate of a turn."""


class SmoothTurn:
    """A turn by ``angle`` [rad] in ``duration`` [s]."""

    def __init__(self, angle: float, *, duration: float) -> None:
        self._angle = angle
        self.duration = duration

    @staticmethod
    def with_peak_rate(angle: float, *, rate: float) -> SmoothTurn:
        """Return the turn with a peak rate [rad/s]."""
        return SmoothTurn(angle, duration=PEAK * abs(angle) / rate)

    def at(self, seconds: Array) -> tuple[Array, Array, Array, Array]:
        """Return the angle and its first three derivatives, (n,) each; held at both ends."""
        u = np.clip(2.0 * seconds / self.duration - 1.0, -1.0, 1.0)
        speed = 2.0 / self.duration
        angle, rate, rate_1, rate_2 = (
            self._angle * speed**order * np.asarray(share(u))
            for order, share in enumerate(_SHARES)
        )
        return angle, rate, rate_1, rate_2

"""A smooth turn from rest to rest: an angle over time, and the circle with this angle.

The rate is proportional to (1 - u^4)^3 for u from -1 to 1: flat in the middle, where it is 1.52
times the mean, and zero with its first two derivatives at both ends.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import PathSamples

_RATE_SHAPE = Polynomial([1.0, 0.0, 0.0, 0.0, -1.0]) ** 3
_ANGLE_SHAPE = _RATE_SHAPE.integ(lbnd=-1.0)
# The completed share of the turn at u, and its derivatives.
_SHARES = [
    _ANGLE_SHAPE / _ANGLE_SHAPE(1.0),
    *((_RATE_SHAPE / _ANGLE_SHAPE(1.0)).deriv(order) for order in range(3)),
]

PEAK = float(2.0 * _SHARES[1](0.0))
"""The highest rate of a turn over its mean."""


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


class CircularPath:
    """A part of a circle from rest to rest."""

    periodic = False

    def __init__(
        self, start: Array, *, forwards: Array, inwards: Array, radius: float, turn: SmoothTurn
    ) -> None:
        """Take the circle at its start.

        Args:
            start: Position (3,) [m].
            forwards: Unit vector (3,) of the first motion.
            inwards: Unit vector (3,) from the start to the centre.
            radius: Radius [m].
            turn: The angle over time.
        """
        self._centre = start + radius * inwards
        self._forwards, self._inwards = radius * forwards, radius * inwards
        self._turn = turn
        self.duration = turn.duration

    def at(self, seconds: Array) -> PathSamples:
        """Return the circle at times (n,) [s]."""
        angle, w, w_1, w_2 = (each[:, None] for each in self._turn.at(seconds))
        along = np.cos(angle) * self._forwards + np.sin(angle) * self._inwards
        inwards = np.cos(angle) * self._inwards - np.sin(angle) * self._forwards
        return PathSamples(
            p_WB=self._centre - inwards,
            v_WB_W=w * along,
            a_WB_W=w**2 * inwards + w_1 * along,
            j_WB_W=3.0 * w * w_1 * inwards + (w_2 - w**3) * along,
        )

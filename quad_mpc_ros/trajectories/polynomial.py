"""Minimum-snap legs: the polynomial between two ends, and how long one may take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.lie import Array
from quad_mpc_ros.trajectories.path import PathSamples

_SHORTEST = 0.3  # s
_GROWTH = 1.05  # of the duration from one trial to the next
_TRIALS = 200
_CHECKED = 101


@dataclass(frozen=True, kw_only=True, eq=False)
class End:
    """One end of a leg, (3,) each: position, velocity, acceleration, jerk; SI units, world.

    A position of None is free: it comes out of the leg.
    """

    p_WB: Array | None
    v_WB_W: Array
    a_WB_W: Array
    j_WB_W: Array

    @staticmethod
    def at_rest(p_WB: Array | None) -> End:
        """Return an end at rest."""
        return End(p_WB=p_WB, v_WB_W=np.zeros(3), a_WB_W=np.zeros(3), j_WB_W=np.zeros(3))

    @staticmethod
    def of(path: PathSamples, place: int) -> End:
        """Return one sample of a path as an end."""
        return End(
            p_WB=path.p_WB[place],
            v_WB_W=path.v_WB_W[place],
            a_WB_W=path.a_WB_W[place],
            j_WB_W=path.j_WB_W[place],
        )

    def derivatives(self) -> list[Array | None]:
        """Return position and its derivatives."""
        return [self.p_WB, self.v_WB_W, self.a_WB_W, self.j_WB_W]


class Leg:
    """The path of least snap between two ends.

    Among all paths with these ends the integral of the squared fourth derivative is least for the
    polynomial of degree 7; where a position is free, for that of degree 6, as the seventh
    derivative must vanish at a free end (Euler and Lagrange's equation, x^(8) = 0, and its natural
    boundary condition).
    """

    periodic = False

    def __init__(self, start: End, end: End, *, duration: float) -> None:
        """Solve for the polynomial; one of the two positions must be given."""
        self.duration = duration
        # In the time 0 to 1, in which the equations are well conditioned.
        fixed = [
            (place, order, value * duration**order)
            for place, ends in ((0.0, start), (1.0, end))
            for order, value in enumerate(ends.derivatives())
            if value is not None
        ]
        rows = [_row(len(fixed), place, order) for place, order, _ in fixed]
        self._coefficients = np.linalg.solve(np.array(rows), np.array([v for _, _, v in fixed]))

    def at(self, seconds: Array) -> PathSamples:
        """Return the leg at times (n,) [s] from 0 to its duration."""
        place = np.clip(seconds / self.duration, 0.0, 1.0)
        p, v, a, j = (self._derivative(place, order) for order in range(4))
        return PathSamples(p_WB=p, v_WB_W=v, a_WB_W=a, j_WB_W=j)

    def _derivative(self, place: Array, order: int) -> Array:
        c = self._coefficients
        derived = np.polynomial.polynomial.polyder(c, order)
        values = np.polynomial.polynomial.polyval(place, derived)
        return np.asarray(values.T / self.duration**order)


def leg_within(start: End, end: End, *, max_speed: float, max_acceleration: float) -> Leg:
    """Return the quickest leg that keeps to a speed [m/s] and an acceleration [m/s^2].

    What an end has already is allowed all along, and a tenth more. The duration is found within
    5 %. Where the jerk of an end lets no leg keep to them, that of the least acceleration is
    returned, to be judged with the whole path.
    """
    ends = (start, end)
    speed = max(max_speed, *(1.1 * float(np.linalg.norm(e.v_WB_W)) for e in ends))
    acceleration = max(max_acceleration, *(1.1 * float(np.linalg.norm(e.a_WB_W)) for e in ends))
    gentlest, least = None, np.inf
    for duration in _SHORTEST * _GROWTH ** np.arange(_TRIALS):
        leg = Leg(start, end, duration=float(duration))
        found = leg.at(np.linspace(0.0, leg.duration, _CHECKED))
        highest = float(np.linalg.norm(found.a_WB_W, axis=1).max())
        if highest <= acceleration and np.linalg.norm(found.v_WB_W, axis=1).max() <= speed:
            return leg
        if gentlest is None or highest < least:
            gentlest, least = leg, highest
    assert gentlest is not None
    return gentlest


def _row(size: int, place: float, order: int) -> Array:
    """Return the derivatives of 1, t, t^2, … of an order at a place."""
    row = np.zeros(size)
    for power in range(order, size):
        factor = float(np.prod(np.arange(power - order + 1, power + 1)))
        row[power] = factor * place ** (power - order)
    return row

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Paths of minimum snap: a leg between two ends, and a path through waypoints.

The integral of the squared fourth derivative is minimal. Between two ends the solution is one
polynomial, through waypoints a spline (Mellinger and Kumar, "Minimum snap trajectory generation
and control for quadrotors", 2011).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import PathSamples, SplinePath
from quad_mpc_ros.references.trajectory import TrajectoryParameters

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

# Search for the duration of a leg.
_SHORTEST_LEG = 0.3  # s
_GROWTH = 1.05  # of the duration from one trial to the next
_TRIALS = 200
_LIMIT_SAMPLES = 101
# Search for the times at waypoints.
_DEGREE = 7
_COARSE, _FINE = 20, 400  # samples a leg: to compare allocations, and to hold the limits
_MOST_OPTIMISED = 12  # legs; beyond that the shares stay as they begin
_SIMPLEX: Any = {"maxfev": 400, "xatol": 1e-2, "fatol": 1e-3}


@dataclass(frozen=True, kw_only=True)
class LegParameters(TrajectoryParameters):
    """Limits of legs of minimum snap."""

    max_speed: float = parameter(
        5.0,
        doc="Highest speed of waypoints, minimum_snap, gates, legs before and after csv, and "
        "requested legs.",
        unit="m/s",
        above=0.0,
        maximum=1e3,
    )
    max_acceleration: float = parameter(
        2.0,
        doc="Highest acceleration of waypoints, minimum_snap, gates, legs before and after csv, "
        "and requested legs.",
        unit="m/s^2",
        above=0.0,
        maximum=1e3,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class End:
    """One end of a leg, (3,) each: position, velocity, acceleration, jerk; SI units, world.

    A position of None is free and follows from the leg.
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


class Leg:
    """The path of minimum snap between two ends.

    Among all paths with these ends the integral of the squared fourth derivative is minimal for
    the polynomial of degree 7; with a free position, of degree 6, as the seventh derivative must
    vanish at a free end (Euler and Lagrange's equation, x^(8) = 0, and its natural boundary
    condition).
    """

    periodic = False

    def __init__(self, start: End, end: End, *, duration: float) -> None:
        """Solve for the polynomial; one of the two positions must be given."""
        self.duration = duration
        # In the time 0 to 1, in which the equations are well conditioned.
        fixed = [
            (place, order, value * duration**order)
            for place, ends in ((0.0, start), (1.0, end))
            for order, value in enumerate((ends.p_WB, ends.v_WB_W, ends.a_WB_W, ends.j_WB_W))
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
    """Return the fastest leg within a speed [m/s] and an acceleration [m/s^2].

    The speed and acceleration of an end, and a tenth more, are always allowed. The duration is
    found within 5 %. If the jerk of an end allows no such leg, the leg with the smallest
    acceleration is returned, to be checked with the whole path.
    """
    ends = (start, end)
    speed = max(max_speed, *(1.1 * float(np.linalg.norm(e.v_WB_W)) for e in ends))
    acceleration = max(max_acceleration, *(1.1 * float(np.linalg.norm(e.a_WB_W)) for e in ends))
    gentlest, least = None, np.inf
    for duration in _SHORTEST_LEG * _GROWTH ** np.arange(_TRIALS):
        leg = Leg(start, end, duration=float(duration))
        found = leg.at(np.linspace(0.0, leg.duration, _LIMIT_SAMPLES))
        highest = float(np.linalg.norm(found.a_WB_W, axis=1).max())
        if highest <= acceleration and np.linalg.norm(found.v_WB_W, axis=1).max() <= speed:
            return leg
        if gentlest is None or highest < least:
            gentlest, least = leg, highest
    assert gentlest is not None
    return gentlest


def _row(size: int, place: float, order: int) -> Array:
    """Return the derivatives of 1, t, t^2, … of an order at a time."""
    derived = np.polynomial.polynomial.polyder(np.eye(size), order)
    return np.asarray(np.polynomial.polynomial.polyval(place, derived))


def minimum_snap_path(points: Array, *, max_speed: float, max_acceleration: float) -> SplinePath:
    """Return the path through ``points`` (n, 3) [m], n > 1, without equal successive points.

    For given times at the waypoints the integral is minimal for the interpolating spline of degree
    7 with zero velocity, acceleration and jerk at both ends: between waypoints the optimum is a
    polynomial of degree 7, and it is continuous up to the sixth derivative (de Boor, "Best
    approximation properties of spline functions of odd degree", 1963). SciPy solves this as one
    banded system. The times minimise the duration: first the shares of the legs, then the whole,
    by uniform scaling of time to the limits.
    """
    from scipy.optimize import minimize

    def duration(shares: Array, *, samples: int) -> float:
        # Spline over 0 to 1: velocity scales with 1/T, acceleration with 1/T^2.
        return _beyond(
            snap_spline(points, _times(shares)),
            np.linspace(0.0, 1.0, samples * len(shares) + 1),
            max_speed=max_speed,
            max_acceleration=max_acceleration,
        )

    shares = _first_shares(points, max_speed=max_speed, max_acceleration=max_acceleration)
    if 1 < len(shares) <= _MOST_OPTIMISED:

        def cost(logarithms: Any) -> float:
            return duration(np.exp(logarithms), samples=_COARSE)

        found = minimize(cost, np.log(shares), method="Nelder-Mead", options=_SIMPLEX)
        shares = np.exp(found.x)
    shortest = duration(shares, samples=_FINE)
    return SplinePath(snap_spline(points, shortest * _times(shares)), duration=shortest)


def snap_spline(points: Array, times: Array) -> BSpline:
    """Return the minimum-snap spline from rest to rest through ``points`` (n, k) at times (n,)."""
    from scipy.interpolate import make_interp_spline

    rest: Any = [(order, np.zeros(points.shape[1])) for order in (1, 2, 3)]
    return make_interp_spline(times, points, k=_DEGREE, bc_type=(rest, rest))


def _times(shares: Array) -> Array:
    """Return the times of the waypoints from 0 to 1."""
    times = np.append(0.0, np.cumsum(shares))
    return np.asarray(times / times[-1])


def _beyond(curve: BSpline, times: Array, *, max_speed: float, max_acceleration: float) -> float:
    """Return the factor by which a spline must be slowed down for the limits at times (n,)."""
    speed = float(np.linalg.norm(curve(times, 1), axis=1).max())
    acceleration = float(np.linalg.norm(curve(times, 2), axis=1).max())
    return max(speed / max_speed, float(np.sqrt(acceleration / max_acceleration)))


def _first_shares(points: Array, *, max_speed: float, max_acceleration: float) -> Array:
    """Return the durations [s] of separate legs from rest to rest, with constant limits."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    ramp = max_speed**2 / max_acceleration  # distance to speed up and slow down again
    quick = 2.0 * np.sqrt(lengths / max_acceleration)
    return np.asarray(
        np.where(lengths < ramp, quick, lengths / max_speed + max_speed / max_acceleration)
    )

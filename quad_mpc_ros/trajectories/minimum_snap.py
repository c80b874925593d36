"""The path of least snap through waypoints, from rest to rest, within a speed and acceleration.

For given times at the waypoints the integral of the squared fourth derivative is least for the
interpolating spline of degree 7 whose velocity, acceleration and jerk vanish at both ends: between
waypoints the optimum is a polynomial of degree 7, and it is continuous up to the sixth derivative
(de Boor, "Best approximation properties of spline functions of odd degree", 1963; Mellinger and
Kumar, "Minimum snap trajectory generation and control for quadrotors", 2011). SciPy solves for it
as one banded system.

The times are chosen so that the whole is short: first the shares of the legs in it, then the
duration, which a uniform scaling of time makes as short as the limits let it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import minimize

from quad_mpc_ros.lie import Array
from quad_mpc_ros.trajectories.spline_path import SplinePath

_DEGREE = 7
_COARSE, _FINE = 20, 400  # samples a leg: to compare allocations, and to hold the limits
_MOST_OPTIMISED = 12  # legs; beyond that the shares stay as they begin
_SIMPLEX: Any = {"maxfev": 400, "xatol": 1e-2, "fatol": 1e-3}


def minimum_snap_path(points: Array, *, max_speed: float, max_acceleration: float) -> SplinePath:
    """Return the path through ``points`` (n, 3) [m], n > 1, no two successive ones the same."""

    def duration(shares: Array, *, samples: int) -> float:
        return _least_duration(
            snap_spline(points, _times(shares)),
            samples=samples * len(shares),
            max_speed=max_speed,
            max_acceleration=max_acceleration,
        )

    shares = _first_shares(points, max_speed=max_speed, max_acceleration=max_acceleration)
    if 1 < len(shares) <= _MOST_OPTIMISED:

        def cost(logarithms: Any) -> float:
            return duration(np.exp(logarithms), samples=_COARSE)

        found = minimize(
            cost,
            np.log(shares),
            method="Nelder-Mead",
            options=_SIMPLEX,
        )
        shares = np.exp(found.x)
    shortest = duration(shares, samples=_FINE)
    return SplinePath(snap_spline(points, shortest * _times(shares)), duration=shortest)


def snap_spline(points: Array, times: Array) -> BSpline:
    """Return the spline of least snap through ``points`` (n, 3) at ``times`` (n,), increasing."""
    rest: Any = [(order, np.zeros(3)) for order in (1, 2, 3)]
    return make_interp_spline(times, points, k=_DEGREE, bc_type=(rest, rest))


def _times(shares: Array) -> Array:
    """Return the times of the waypoints from 0 to 1."""
    times = np.append(0.0, np.cumsum(shares))
    return np.asarray(times / times[-1])


def _least_duration(
    unit: BSpline, *, samples: int, max_speed: float, max_acceleration: float
) -> float:
    """Return how long the spline over 0 to 1 must take: velocity falls as 1/T, then 1/T^2."""
    places = np.linspace(0.0, 1.0, samples + 1)
    speed = float(np.linalg.norm(unit(places, 1), axis=1).max())
    acceleration = float(np.linalg.norm(unit(places, 2), axis=1).max())
    return max(speed / max_speed, float(np.sqrt(acceleration / max_acceleration)))


def _first_shares(points: Array, *, max_speed: float, max_acceleration: float) -> Array:
    """Return durations [s] as of legs flown one by one from rest to rest, with constant limits."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    ramp = max_speed**2 / max_acceleration  # way to speed up and slow down again
    quick = 2.0 * np.sqrt(lengths / max_acceleration)
    return np.asarray(
        np.where(lengths < ramp, quick, lengths / max_speed + max_speed / max_acceleration)
    )

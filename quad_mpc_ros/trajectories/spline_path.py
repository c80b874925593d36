"""A path along a B-spline."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from quad_mpc_ros.lie import Array
from quad_mpc_ros.trajectories.path import PathSamples


class SplinePath:
    """A spline of degree 5 or more from 0 to ``duration`` [s] with values (n, 3) [m]."""

    periodic = False

    def __init__(self, curve: BSpline, *, duration: float) -> None:
        self.duration = duration
        self._curves = [curve.derivative(order) if order else curve for order in range(4)]

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s] from 0 to its duration."""
        seconds = np.clip(seconds, 0.0, self.duration)
        p, v, a, j = (np.asarray(curve(seconds)) for curve in self._curves)
        return PathSamples(p_WB=p, v_WB_W=v, a_WB_W=a, j_WB_W=j)

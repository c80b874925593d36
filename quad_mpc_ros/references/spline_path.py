"""A path along a B-spline."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.references.path import PathSamples


class SplinePath:
    """A spline of degree 5 or more from 0 to ``duration`` [s] with values (n, 3) [m].

    ``yaw`` is another, with values (n,) [rad]; without one it is 0.
    """

    periodic = False

    def __init__(self, curve: BSpline, *, duration: float, yaw: BSpline | None = None) -> None:
        self.duration = duration
        self._curves = [curve.derivative(order) if order else curve for order in range(4)]
        self._yaws = None if yaw is None else (yaw, yaw.derivative())

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s] from 0 to its duration."""
        seconds = np.clip(seconds, 0.0, self.duration)
        p, v, a, j = (np.asarray(curve(seconds)) for curve in self._curves)
        yaw = yaw_rate = np.zeros(len(seconds))
        if self._yaws is not None:
            yaw, yaw_rate = (np.asarray(curve(seconds)) for curve in self._yaws)
        return PathSamples(p_WB=p, v_WB_W=v, a_WB_W=a, j_WB_W=j, yaw=yaw, yaw_rate=yaw_rate)

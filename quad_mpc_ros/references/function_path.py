# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A path of a plain function p(t); derivatives come from a spline through its samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from quad_mpc_ros.configuration import ArgumentError
from quad_mpc_ros.configuration.arguments import number
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import PathSamples, SplinePath

_STEP, _LEAST_SAMPLES, _MOST_SAMPLES = 0.02, 50, 20_000  # s
_SAME = 1e-6  # m, at both ends of a period


class FunctionPath(SplinePath):
    """A reference of a function of time.

    Args:
        function: Position (3,) [m] in the world at a time [s]; with a fourth number, the yaw [rad]
            from east to north. Three times continuously differentiable.
        duration: Duration, or period [s]; later the vehicle holds the last position.
        periodic: Whether the function repeats after ``duration``.

    Raises:
        ArgumentError: The function returns something else, or does not repeat.

    Example:
        >>> from math import cos, sin
        >>> def circle(t):
        ...     return cos(t), sin(t), 2.0
        >>> path = FunctionPath(circle, duration=6.2831853, periodic=True)
        >>> simulate(trajectory=path, on_reference=True, duration=1.0).p_WB.shape
        (50, 3)
    """

    def __init__(
        self,
        function: Callable[[float], Sequence[float] | Array],
        *,
        duration: float,
        periodic: bool = False,
    ) -> None:
        from scipy.interpolate import make_interp_spline

        duration = number(duration, "duration", above=0.0)
        count = int(np.clip(duration / _STEP, _LEAST_SAMPLES, _MOST_SAMPLES)) + 1
        times = np.linspace(0.0, duration, count)
        values = np.array([function(t) for t in times.tolist()], dtype=np.float64)
        if values.shape not in ((count, 3), (count, 4)) or not np.isfinite(values).all():
            raise ArgumentError("function", function(0.0), "3 or 4 finite numbers at any time")
        if periodic and np.abs(values[-1] - values[0]).max() > _SAME:
            raise ArgumentError("function", values[-1], f"the values at t = 0, {values[0]}")
        if periodic:
            values[-1] = values[0]
        self.periodic = periodic
        curve = make_interp_spline(times, values, k=5, bc_type="periodic" if periodic else None)
        super().__init__(curve, duration=duration)

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s] from 0 to its duration, or endless."""
        return super().at(np.mod(seconds, self.duration) if self.periodic else seconds)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Your own reference: a path with derivatives; attitude and rates follow from flatness.

p(t) = (r cos w t, r sin w t, h + c sin 2 w t): a crown. Your package can also register the
reference for all commands and nodes: CONTRIBUTING.md, "Add a reference".
"""

import math

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros import simulate, summarise
from quad_mpc_ros.references.path import PathSamples


class Crown:
    """A circle of six seconds with two vertical oscillations."""

    periodic = True
    duration = 6.0

    def at(self, seconds: NDArray[np.float64]) -> PathSamples:
        """Return position, velocity, acceleration and jerk (n, 3) at times (n,) [s]."""
        p, v, a, j = (self.derivative(seconds, order) for order in range(4))
        return PathSamples(p_WB=p, v_WB_W=v, a_WB_W=a, j_WB_W=j)

    def derivative(self, t: NDArray[np.float64], order: int) -> NDArray[np.float64]:
        """Each derivative advances the phase by a quarter period and adds a factor."""
        w, turn = math.tau / self.duration, order * math.pi / 2
        east = 2.0 * w**order * np.cos(w * t + turn)
        north = 2.0 * w**order * np.sin(w * t + turn)
        up = 0.5 * (2.0 * w) ** order * np.sin(2.0 * w * t + turn) + (3.0 if order == 0 else 0.0)
        return np.stack((east, north, up), axis=1)


flight = simulate(trajectory=Crown(), on_reference=True, duration=12.0)
rmse = summarise(flight)["position_rmse_m"]
speed = np.linalg.norm(flight.v_WB_B, axis=1)
print(f"two laps of the crown at up to {speed.max():.1f} m/s, RMSE {1000 * rmse:.2f} mm")

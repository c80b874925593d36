"""Steady wind and gusts."""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.parameters import PlantParameters, Stream, white_noise

NEVER_NS = 2**63 - 1
_GUST_PERIOD_NS = 10_000_000
_LOWEST_AIRSPEED = 1.0


class Wind:
    """Steady wind and Dryden gusts, world axes, m/s.

    Each axis of the gusts is white noise through the longitudinal Dryden filter of MIL-F-8785C
    and MIL-HDBK-1797,

        H(s) = sigma sqrt(2 L / (pi V)) / (1 + s L / V),

    with the intensity sigma, the scale length L and the airspeed V. The filter is discretised
    exactly, with 100 values per second that are held in between: g' = a g + sigma sqrt(1 - a^2) n
    with a = exp(-V dt / L) and n from N(0, 1), which keeps the variance at sigma^2. The standards
    use a second-order filter across the flight path. A hovering vehicle has no flight path, so all
    axes have the same filter. V is the airspeed in the steady wind, but at least 1 m/s, because
    otherwise the gusts would be constant at hover.
    """

    def __init__(self, config: PlantParameters) -> None:
        self._steady_W = np.array(config.wind)
        self._intensity, self._length = config.gust_intensity, config.gust_length
        self._noise = white_noise(config.random(Stream.GUSTS), 3)
        self._gust_W = np.zeros(3)
        self.next_ns = NEVER_NS
        """Time of the next change of the gusts."""
        if self._intensity > 0.0:
            self._gust_W = self._intensity * next(self._noise)
            self.next_ns = _GUST_PERIOD_NS
        self.velocity_W: Array = self._steady_W + self._gust_W
        """Velocity of the air (3,) [m/s]."""

    def advance_to(self, time_ns: int, *, v_WB_W: Array) -> None:
        """Update the gusts up to a time, for a vehicle with a velocity (3,) [m/s]."""
        while self.next_ns <= time_ns:
            through_air = v_WB_W - self._steady_W
            self._change(math.sqrt(through_air.dot(through_air)))
            self.next_ns += _GUST_PERIOD_NS

    def _change(self, airspeed: float) -> None:
        passed = max(airspeed, _LOWEST_AIRSPEED) * _GUST_PERIOD_NS * 1e-9
        kept = math.exp(-passed / self._length)
        fresh = self._intensity * math.sqrt(1.0 - kept * kept)
        self._gust_W = kept * self._gust_W + fresh * next(self._noise)
        self.velocity_W = self._steady_W + self._gust_W

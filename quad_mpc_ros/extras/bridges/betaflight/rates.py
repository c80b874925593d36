# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Rate curves from stick to body rate, and the pulse for a body rate.

As in the firmware's ``rc.c``, with the numbers of its command line (``roll_rc_rate``,
``roll_srate``, ``roll_expo``).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.lie import Array

MIDDLE, SPAN = 1500, 500  # us
_OFFSETS = np.arange(SPAN + 1.0)
RATE_KINDS = "ACTUAL", "BETAFLIGHT", "QUICK"

_RC_RATE_INCREMENT = 14.54  # deg/s over a hundredth of rc_rate beyond 2, of BETAFLIGHT
_MIN_DIVISOR = 0.01


@dataclass(frozen=True, kw_only=True)
class RateCurve:
    """The curve of one axis: ``kind`` ACTUAL, BETAFLIGHT or QUICK; ``limit`` in deg/s."""

    kind: str
    rc_rate: int
    super_rate: int
    expo: int
    limit: float = 1998.0

    @functools.cached_property
    def _rates(self) -> Array:
        """The body rates of all stick positions, every microsecond."""
        return self.rate(_OFFSETS / SPAN)

    def pulse(self, rate: float) -> float:
        """Return the pulse width [us] for a body rate [rad/s], saturated at full stick."""
        offset = float(np.interp(abs(rate), self._rates, _OFFSETS))
        return MIDDLE + math.copysign(offset, rate)

    def rate(self, stick: Array) -> Array:
        """Return the body rates (n,) [rad/s] of stick positions (n,) in [0, 1]."""
        match self.kind:
            case "ACTUAL":
                degrees = self._actual(stick)
            case "BETAFLIGHT":
                degrees = self._betaflight(stick)
            case "QUICK":
                degrees = self._quick(stick)
            case _:
                raise ValueError(f"rates type {self.kind}")
        return np.radians(np.minimum(degrees, self.limit))

    def _actual(self, stick: Array) -> Array:
        expo = self.expo / 100.0
        bent = stick * (stick**5 * expo + stick * (1.0 - expo))
        centre = 10.0 * self.rc_rate
        return stick * centre + max(10.0 * self.super_rate - centre, 0.0) * bent

    def _betaflight(self, stick: Array) -> Array:
        expo, rate = self.expo / 100.0, self.rc_rate / 100.0
        if rate > 2.0:
            rate += _RC_RATE_INCREMENT * (rate - 2.0)
        bent = stick * (stick**3 * expo + 1.0 - expo)
        return 200.0 * rate * bent / np.maximum(1.0 - stick * self.super_rate / 100.0, 0.01)

    def _quick(self, stick: Array) -> Array:
        expo, rate = self.expo / 100.0, 2.0 * self.rc_rate
        highest = max(10.0 * self.super_rate, rate)
        bent = stick**3 * expo + stick * (1.0 - expo)
        divisor = 1.0 - bent * (1.0 - rate / highest)
        return stick * rate / np.maximum(divisor, _MIN_DIVISOR)

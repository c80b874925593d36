"""The voltage of a battery as the thrust is scaled by it."""

from __future__ import annotations

import math

# s: the voltage sags with every burst of thrust, and what follows it shall not follow each.
_TIME_CONSTANT = 2.0


class SmoothedVoltage:
    """A voltage [V] that follows measured ones with a lag of first order, from the first on."""

    def __init__(self) -> None:
        self.value: float | None = None
        """The voltage [V]; None until one was measured."""
        self._time_ns = 0

    def receive(self, voltage: float, *, now_ns: int) -> bool:
        """Take a measured voltage [V], unless no battery can have it; return whether it counts."""
        if not 0.0 < voltage < math.inf:
            return False
        if self.value is None:
            self.value = voltage
        else:
            elapsed = max(now_ns - self._time_ns, 0) * 1e-9
            share = 1.0 - math.exp(-elapsed / _TIME_CONSTANT)
            self.value += share * (voltage - self.value)
        self._time_ns = now_ns
        return True

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The voltage of a battery that scales the thrust."""

from __future__ import annotations

import math

from quad_mpc_ros.control.lie.formulas import lowpass_share

_TIME_CONSTANT = 2.0  # s, longer than the voltage sags with each burst of thrust
_UNKNOWN_VOLTAGE = 65.535  # V: MAVLink's UINT16_MAX in millivolts, which MAVROS and others pass on
_MAX_VOLTAGE = 120.0  # V: 28 cells
# Shares of the expected voltage: a cell has 2.5 V to 4.35 V, and is expected at 3.5 V or more.
_LEAST_SHARE, _MOST_SHARE = 0.6, 1.5


def measured_voltage(voltage: float) -> float | None:
    """Return a reported battery voltage [V]; None if the value means unknown."""
    known = 0.0 < voltage < math.inf and abs(voltage - _UNKNOWN_VOLTAGE) > 1e-3
    return voltage if known else None


class SmoothedVoltage:
    """A voltage [V] that follows measured voltages with a first-order lag, from the first on."""

    def __init__(self, *, expected: float = 0.0) -> None:
        """Expect voltages near a nominal voltage [V], unless 0."""
        self.value: float | None = None
        """The voltage [V]; None until one was measured."""
        self.least = _LEAST_SHARE * expected
        self.most = min(_MOST_SHARE * expected, _MAX_VOLTAGE) if expected else _MAX_VOLTAGE
        self._time_ns = 0

    def receive(self, voltage: float, *, now_ns: int) -> bool:
        """Take a voltage [V] if known and between ``least`` and ``most``; return success."""
        if measured_voltage(voltage) is None or not self.least <= voltage <= self.most:
            return False
        if self.value is None:
            self.value = voltage
        else:
            elapsed = max(now_ns - self._time_ns, 0) * 1e-9
            share = lowpass_share(elapsed, _TIME_CONSTANT)
            self.value += share * (voltage - self.value)
        self._time_ns = now_ns
        return True

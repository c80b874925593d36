# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of the MPC's throttle to thrust and to the stack's throttle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quad_mpc_ros.control.model.vehicle import inverse_throttle_curve
from quad_mpc_ros.control.model.voltage import SmoothedVoltage, measured_voltage
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.preflight.finding import Finding, error, warning

_BATTERY_SCALE_LIMITS = (0.5, 1.5)
_MAX_HOVER_THROTTLE = 0.8  # of the stack's throttle


class ThrustMap:
    """Thrust as a function of the MPC's throttle and of the stack's throttle."""

    def __init__(self, config: BridgeConfig) -> None:
        self._model = config.vehicle()
        self._parameters = config.thrust_map
        self._voltage = SmoothedVoltage(expected=config.thrust_map.battery_voltage)
        self._has_refused_voltage = False

    def thrust_newton(self, model_throttle: float) -> float:
        """Return the collective thrust [N] at the MPC's throttle, at least 0."""
        return max(self._model.thrust(model_throttle), 0.0)

    def specific_thrust(self, model_throttle: float) -> float:
        """Return the specific thrust [m/s^2] at the MPC's throttle."""
        return self.thrust_newton(model_throttle) / self._model.mass

    def stack_throttle(self, model_throttle: float) -> float:
        """Return the stack's throttle in [0, 1] with the nearest thrust."""
        if self._parameters.kind == "model" and self.battery_scale == 1.0:
            return model_throttle
        return self._inverse(self._model.thrust(model_throttle) / self.battery_scale)

    def receive_voltage(self, voltage: float, *, now_ns: int) -> str:
        """Receive a battery voltage [V]; return a warning, once, if it is ignored.

        Invalid voltages are ignored without a warning.
        """
        expected, bounds = self._parameters.battery_voltage, self._voltage
        if expected == 0.0 or bounds.receive(voltage, now_ns=now_ns):
            return ""
        if measured_voltage(voltage) is None or self._has_refused_voltage:
            return ""
        self._has_refused_voltage = True
        return (
            f"battery voltage: given {voltage:g} V, expected {bounds.least:.3g} V to "
            f"{bounds.most:.3g} V for thrust_map.battery_voltage {expected:g} V; ignored: check "
            "its unit and the number of cells"
        )

    @property
    def battery_scale(self) -> float:
        """Ratio of current thrust to thrust of the map; 1 until a voltage is known."""
        if self._voltage.value is None:
            return 1.0
        ratio = self._voltage.value / self._parameters.battery_voltage
        low, high = _BATTERY_SCALE_LIMITS
        return float(min(max(ratio**self._parameters.battery_exponent, low), high))

    def _inverse(self, thrust: float) -> float:
        if self._parameters.kind == "linear":
            throttle = thrust / self._parameters.full_thrust
        elif self._parameters.kind == "table":
            throttle = float(
                np.interp(thrust, self._parameters.table_thrust, self._parameters.table_throttle)
            )
        else:
            is_own = self._parameters.kind == "quadratic"
            a, b, c = self._parameters.motor_curve if is_own else self._model.thrust_curve
            throttle = inverse_throttle_curve(a, b, c, thrust / self._model.motor_count)
        return min(max(throttle, 0.0), 1.0)


def thrust_map_findings(bridge: BridgeConfig) -> Iterator[Finding]:
    """Yield a finding if the stack's hover throttle is out of range or near the upper end."""
    kind, weight = bridge.thrust_map.kind, bridge.mass * bridge.gravity
    hover = ThrustMap(bridge).stack_throttle(bridge.vehicle().hover_throttle)
    remedy = "check thrust_map against mass and thrust_curve"
    if not 0.0 < hover < 1.0:
        yield error(
            f"thrust map ({kind}): given hover throttle {hover:g} for a weight of "
            f"{weight:.3g} N, expected 0 to 1",
            remedy,
        )
    elif hover > _MAX_HOVER_THROTTLE:
        yield warning(
            f"thrust map ({kind}): hover at the stack's throttle {hover:.2f}, expected "
            f"{_MAX_HOVER_THROTTLE:g} or less",
            remedy,
        )

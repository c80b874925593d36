"""Voltage and current of the battery at the power of the rotors, compiled."""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.simulation.rotors.craft import Craft


@compiled
def battery(power: float, used: float, craft: Craft) -> tuple[float, float]:
    """Return the voltage relative to a full battery, and the current [A].

    ``power`` [W] is drawn by the rotors, ``used`` [A s] is the charge used so far. The voltage
    without current U falls linearly with the charge. With the current I the voltage is V = U - R
    I, and V I is the power over the efficiency: V^2 - U V + R P = 0. The larger root is the
    operating point. The power saturates at the battery's maximum, where V = U / 2.
    """
    if craft.capacity == 0.0:
        return 1.0, 0.0
    left = max(1.0 - used / craft.capacity, 0.0)
    idle = craft.voltage_empty + left * (craft.voltage_full - craft.voltage_empty)
    asked = power / craft.efficiency
    root = math.sqrt(max(idle * idle - 4.0 * craft.resistance * asked, 0.0))
    voltage = 0.5 * (idle + root)
    most = 0.25 * idle * idle / craft.resistance if craft.resistance > 0.0 else asked
    return voltage / craft.voltage_full, min(asked, most) / voltage

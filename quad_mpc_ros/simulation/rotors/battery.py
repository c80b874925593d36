"""The battery under the power that the rotors take, compiled."""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.simulation.rotors.craft import Craft


@compiled
def battery(power: float, used: float, craft: Craft) -> tuple[float, float]:
    """Return the voltage over that of a full battery, and the current [A].

    ``power`` [W] is the rotors', ``used`` [A s] the charge taken so far. The voltage without
    current U falls linearly with the charge; under current I it is V = U - R I, and V I is the
    power over the efficiency: V^2 - U V + R P = 0, of which the greater root is the one that
    motors work at. More power than the battery can give is cut where it gives most, V = U / 2.
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

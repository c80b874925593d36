"""Parameters of a vehicle file, which have the same meaning for every node.

It is a ROS parameter file with these below ``/**``. Each node reads its share; parameters for a
node by name have precedence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.configuration.errors import text_of

VEHICLE = (
    "mass",
    "gravity",
    "motor_count",
    "thrust_curve",
    "drag",
    "rotor_drag",
    "translational_lift",
    "rate_time_constant",
    "torque_time_constant",
    "angular_acceleration_max",
    "rate_gain",
    "thrust_time_constant",
    "thrust_time_constant_down",
    "input_delay",
    "omega_max",
    "throttle_min",
    "throttle_max",
    "radius",
)
LIFT_PARAMETERS = ("mass", "gravity", "motor_count", "thrust_curve")
"""Parameters that determine the acceleration at a throttle, and must not differ between nodes."""
_THRUST_MAP = "thrust_map."


def describes_vehicle(name: str) -> bool:
    """Return whether a parameter is one of the vehicle, or of the bridge's thrust map."""
    return name in VEHICLE or name.startswith(_THRUST_MAP)


def disagreements(vehicles: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return the parameters in which the vehicles of nodes differ, with the values of each node.

    The values read like ``mass 0.9 of mpc, 0.5 of reference and px4_bridge``. Only parameters of
    several nodes are compared; one number for all body axes equals three equal numbers.
    """
    found: dict[str, str] = {}
    for name in dict.fromkeys(name for values in vehicles.values() for name in values):
        groups: list[tuple[Any, list[str]]] = []
        for node, values in vehicles.items():
            if name not in values:
                continue
            alike = next((nodes for value, nodes in groups if _alike(value, values[name])), None)
            if alike is None:
                groups.append((values[name], [node]))
            else:
                alike.append(node)
        if len(groups) > 1:
            groups_text = (f"{text_of(value)} of {' and '.join(nodes)}" for value, nodes in groups)
            found[name] = f"{name} {', '.join(groups_text)}"
    return found


def _alike(a: Any, b: Any) -> bool:
    first, second = (list(v) if isinstance(v, list | tuple) else [v] for v in (a, b))
    length = max(len(first), len(second))
    first, second = (v * length if len(v) == 1 else v for v in (first, second))
    return len(first) == len(second) and all(
        math.isclose(x, y, rel_tol=1e-9, abs_tol=1e-12) for x, y in zip(first, second, strict=True)
    )

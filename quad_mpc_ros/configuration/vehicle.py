"""What a vehicle file may state: parameters that mean the same to every node.

It is a ROS parameter file with these below ``/**``. Each node reads its share and leaves the rest;
what a file states for a node by name wins over it.
"""

from __future__ import annotations

VEHICLE = (
    "mass",
    "gravity",
    "motor_count",
    "thrust_curve",
    "drag",
    "rotor_drag",
    "translational_lift",
    "rate_time_constant",
    "rate_gain",
    "thrust_time_constant",
    "input_delay",
    "omega_max",
    "throttle_min",
    "throttle_max",
)
_THRUST_MAP = "thrust_map."


def describes_vehicle(name: str) -> bool:
    """Return whether a parameter is one of the vehicle, or of the bridge's thrust map."""
    return name in VEHICLE or name.startswith(_THRUST_MAP)

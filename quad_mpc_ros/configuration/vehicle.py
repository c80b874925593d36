# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a vehicle file, which have the same meaning for every node.

A vehicle file is a ROS parameter file with these parameters below ``/**``. Each node reads its
share; parameters of a named node have precedence.
"""

from __future__ import annotations

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
    "latency_uncertainty",
    "omega_max",
    "throttle_min",
    "throttle_max",
    "radius",
)
LIFT_PARAMETERS = ("mass", "gravity", "motor_count", "thrust_curve")
"""Parameters that determine the acceleration at a throttle, and must not differ between nodes."""
_THRUST_MAP = "thrust_map."


def describes_vehicle(name: str) -> bool:
    """Return whether a parameter belongs to the vehicle or to the bridge's thrust map."""
    return name in VEHICLE or name.startswith(_THRUST_MAP)


def disagreements(vehicles: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return the vehicle parameters that differ between nodes, with the values of each node.

    The values read like ``mass 0.9 of mpc, 0.5 of reference and px4_bridge``. Only parameters of
    several nodes are compared; one number for all body axes equals three equal numbers.
    """
    found: dict[str, str] = {}
    for name in dict.fromkeys(name for values in vehicles.values() for name in values):
        groups: dict[tuple[str, ...], tuple[Any, list[str]]] = {}
        for node, values in vehicles.items():
            if name in values:
                _, nodes = groups.setdefault(_rounded(values[name]), (values[name], []))
                nodes.append(node)
        if len(groups) > 1:
            texts = (f"{text_of(v)} of {' and '.join(nodes)}" for v, nodes in groups.values())
            found[name] = f"{name} {', '.join(texts)}"
    return found


def _rounded(value: Any) -> tuple[str, ...]:
    """Return numbers with 9 digits; one number if all are equal."""
    numbers = tuple(f"{x:.9g}" for x in (value if isinstance(value, list | tuple) else [value]))
    return numbers[:1] if len(set(numbers)) == 1 else numbers

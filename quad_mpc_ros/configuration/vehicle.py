"""What a vehicle file may state: parameters that mean the same to every node.

It is a ROS parameter file with these below ``/**``. Each node reads its share and leaves the rest;
what a file states for a node by name wins over it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

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


def differences(given: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """Return the parameters in which two nodes' vehicles differ, with both values.

    Only what both know is compared; one number for all body axes is three alike.
    """
    return [
        f"{name} {_shown(value)} and {_shown(other[name])}"
        for name, value in given.items()
        if name in other and not _alike(value, other[name])
    ]


def _alike(a: Any, b: Any) -> bool:
    first, second = (list(v) if isinstance(v, list | tuple) else [v] for v in (a, b))
    length = max(len(first), len(second))
    first, second = (v * length if len(v) == 1 else v for v in (first, second))
    return len(first) == len(second) and all(
        math.isclose(x, y, rel_tol=1e-9, abs_tol=1e-12) for x, y in zip(first, second, strict=True)
    )


def _shown(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:.6g}"

"""Whether the nodes of a vehicle were given the same one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.configuration.vehicle import LIFT_PARAMETERS, disagreements
from quad_mpc_ros.ros.preflight.finding import Finding, error, warning

# The simulator may fly another vehicle than its controller knows: to see what then happens.
_SIMULATOR = "simulator"
_REMEDY = "give every node the same vehicle file"


def vehicle_findings(vehicles: Mapping[str, Mapping[str, Any]]) -> list[Finding]:
    """Return what differs between the vehicles of nodes: what must not, and what may."""
    graver = carried_differently(vehicles)
    others = [
        text
        for name, text in disagreements(vehicles).items()
        if name not in LIFT_PARAMETERS or not graver
    ]
    found = [*graver]
    if others:
        found.append(
            warning(f"vehicles differ: {'; '.join(others)}", f"{_REMEDY}, unless it is a test")
        )
    return found


def carried_differently(vehicles: Mapping[str, Mapping[str, Any]]) -> list[Finding]:
    """Return an error where nodes that fly one vehicle differ in what carries it.

    The rest decides only how well it flies.
    """
    carried = {
        node: {name: values[name] for name in LIFT_PARAMETERS if name in values}
        for node, values in vehicles.items()
        if node != _SIMULATOR
    }
    differ = disagreements(carried)
    if not differ:
        return []
    return [error(f"vehicles differ: {'; '.join(differ.values())}", _REMEDY)]

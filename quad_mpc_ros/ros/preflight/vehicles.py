# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Check that the nodes of a vehicle have the same vehicle parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.configuration.vehicle import LIFT_PARAMETERS, disagreements
from quad_mpc_ros.ros.preflight.finding import Finding, error, warning

# The simulator may simulate another vehicle than the controller's, for tests.
_SIMULATOR = "simulator"
_REMEDY = "give every node the same vehicle file"


def vehicle_findings(vehicles: Mapping[str, Mapping[str, Any]]) -> list[Finding]:
    """Return errors and warnings for different vehicle parameters of nodes."""
    graver = carried_differently(vehicles)
    others = [
        text
        for name, text in disagreements(vehicles).items()
        if name not in LIFT_PARAMETERS or not graver
    ]
    if not others:
        return graver
    remedy = f"{_REMEDY}, unless it is a test"
    return [*graver, warning(f"vehicles differ: {'; '.join(others)}", remedy)]


def carried_differently(vehicles: Mapping[str, Mapping[str, Any]]) -> list[Finding]:
    """Return an error if nodes of one vehicle differ in parameters of its lift.

    Other parameters affect only the tracking.
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

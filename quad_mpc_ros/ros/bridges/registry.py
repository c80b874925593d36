# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The registered bridges of this and other packages, found by entry points.

A package registers a bridge with an entry point ``name = module:Class`` in the group
``quad_mpc_ros.bridges`` and an executable ``name = quad_mpc_ros.entry:name``. No message package
is imported.
"""

from __future__ import annotations

import contextlib
from importlib.metadata import entry_points
from typing import Any

from quad_mpc_ros.configuration import Configuration, UserError, registered
from quad_mpc_ros.configuration.extension import BRIDGES, registered_names
from quad_mpc_ros.configuration.spelling import did_you_mean


def bridge_packages() -> dict[str, str]:
    """Return the ROS package of each registered bridge by name, without loading bridges."""
    return {
        each.name: each.dist.name.replace("-", "_")
        for each in sorted(entry_points(group=BRIDGES), key=lambda entry: entry.name)
        if each.dist is not None
    }


def bridge_configurations() -> dict[str, type[Configuration]]:
    """Return the parameters of each loadable bridge by node name."""
    found: dict[str, type[Configuration]] = {}
    for name in sorted(registered_names(BRIDGES)):
        with contextlib.suppress(UserError, AttributeError):  # reported when it is started
            bridge: Any = registered(BRIDGES, name)
            found[str(bridge.name)] = bridge.Config
    return found


def load_bridge(name: str) -> Any:
    """Return a bridge by its name, with or without ``_bridge``. Raises :class:`UserError`."""
    names = sorted(registered_names(BRIDGES))
    found = next((each for each in (name, f"{name}_bridge") if each in names), None)
    if found is None:
        near = did_you_mean(name, [*names, *(each.removesuffix("_bridge") for each in names)])
        raise UserError(f"--bridge: given {name!r}, expected one of {', '.join(names)}{near}")
    return registered(BRIDGES, found)

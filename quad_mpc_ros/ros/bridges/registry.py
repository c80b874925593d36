# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The registered bridges of this and other packages, found by entry points.

A package registers a bridge with an entry point ``name = module:Class`` in the group
``quad_mpc_ros.bridges`` and an executable ``name = quad_mpc_ros.entry:name``. No message package
is imported.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from quad_mpc_ros.configuration import Configuration, UserError
from quad_mpc_ros.configuration.extension import BRIDGES
from quad_mpc_ros.configuration.spelling import did_you_mean


def bridge_packages() -> dict[str, str]:
    """Return the ROS package of each registered bridge by name, without loading bridges."""
    packages = {each.name: each.dist.name for each in _entries() if each.dist is not None}
    return {name: package.replace("-", "_") for name, package in packages.items()}


def bridge_configurations() -> dict[str, type[Configuration]]:
    """Return the parameters of each loadable bridge by node name."""
    found: dict[str, type[Configuration]] = {}
    for entry in _entries():
        try:
            bridge: Any = entry.load()
            found[str(bridge.name)] = bridge.Config
        except (ImportError, AttributeError):  # reported when it is started
            continue
    return found


def load_bridge(name: str) -> Any:
    """Return a bridge by its name, with or without ``_bridge``. Raises :class:`UserError`."""
    entries = {entry.name: entry for entry in _entries()}
    entry = entries.get(name) or entries.get(f"{name}_bridge")
    if entry is None:
        raise UserError(
            f"--bridge: given {name!r}, expected one of {', '.join(entries)}"
            f"{did_you_mean(name, [*entries, *(e.removesuffix('_bridge') for e in entries)])}"
        )
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        raise UserError(f"{entry.name}: {entry.value} cannot be loaded: {error}") from error


def _entries() -> list[EntryPoint]:
    return sorted(entry_points(group=BRIDGES), key=lambda entry: entry.name)

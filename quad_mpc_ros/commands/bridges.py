"""``quad_mpc bridges``: the bridges to flight stacks, and what is installed for them."""

from __future__ import annotations

import argparse

from quad_mpc_ros.bridges.registry import GROUP, RegisteredBridge, registered_bridges
from quad_mpc_ros.configuration import UserError


def list_bridges(_: argparse.Namespace) -> int:
    """Print every registered bridge. Raises :class:`UserError` when there is none."""
    found = registered_bridges()
    if not found:
        raise UserError(
            f"no package has registered a bridge in the entry points {GROUP}: install "
            "quad_mpc_ros with pip or colcon"
        )
    width = max(len(bridge.name) for bridge in found)
    for bridge in found:
        print(f"{bridge.name:<{width}}  {_state(bridge)}")
    return 0


def _state(bridge: RegisteredBridge) -> str:
    if bridge.fault:
        return f"broken: {bridge.fault}"
    if bridge.missing:
        return f"{bridge.speaks} - missing {', '.join(bridge.missing)}: {bridge.how_to_get}"
    return f"{bridge.speaks} - installed"

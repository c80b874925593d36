"""``quad_mpc bridges``: the bridges to flight stacks, and what is installed for them."""

from __future__ import annotations

import argparse

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.extension import BRIDGES
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.ros.bridges.registry import RegisteredBridge, registered_bridges


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add nothing."""
    parser.description = (
        "List every registered bridge, and how to get the message packages that are missing."
        " Start one with: ros2 run quad_mpc_ros NAME."
    )


def run(_: argparse.Namespace) -> int:
    """Print every registered bridge. Raises :class:`UserError` when there is none."""
    found = registered_bridges()
    if not found:
        raise UserError(
            f"no package has registered a bridge in the entry points {BRIDGES}: install "
            "quad_mpc_ros with pip or colcon"
        )
    rows = [(bridge.name, _state(bridge)) for bridge in found]
    print("\n".join(text_table(rows, align="ll")))
    return 0


def _state(bridge: RegisteredBridge) -> str:
    if bridge.fault:
        return f"broken: {bridge.fault}"
    if bridge.missing:
        return f"{bridge.speaks} - missing {', '.join(bridge.missing)}: {bridge.how_to_get}"
    return f"{bridge.speaks} - installed"

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc preflight``: check the running nodes of a vehicle before a flight."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.processes import require_ros
from quad_mpc_ros.commands.run_options import add_config
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.text_tables import text_table

if TYPE_CHECKING:
    from collections.abc import Sequence

_NONE = "none"
_MIN_TIMEOUT = 1.0  # s


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the vehicle and its expected configuration."""
    parser.description = (
        "Check the running nodes of a vehicle before a flight, and print a line for each check: "
        "ok, or what to do (docs/howto/preflight.md). The command changes nothing. Exit code 0 "
        "without errors (warnings are allowed), 1 with errors, 2 for bad input."
    )
    parser.add_argument(
        "--namespace", default="", metavar="NS", help="namespace of the vehicle (default: none)"
    )
    parser.add_argument(
        "--bridge",
        default="",
        metavar="NAME",
        help="required bridge, for example px4, or none (default: the running bridge or the "
        "simulator)",
    )
    add_config(parser, "that the nodes should use")
    parser.add_argument(
        "--timeout",
        type=float,
        default=10.0,
        metavar="S",
        help="time to wait for nodes, answers and odometry (default: 10)",
    )


def run(options: argparse.Namespace) -> int:
    """Check, print and return the exit code."""
    if not _MIN_TIMEOUT <= options.timeout < float("inf"):
        raise UserError(f"--timeout: given {options.timeout}, expected {_MIN_TIMEOUT:g} or more")
    require_ros("preflight", instead="; without ROS 2, use 'simulate' and 'campaign'")
    from quad_mpc_ros.commands.observer import checked_namespace
    from quad_mpc_ros.commands.running_vehicle import RunningVehicle
    from quad_mpc_ros.ros.bridges.registry import load_bridge
    from quad_mpc_ros.ros.preflight.checks import findings
    from quad_mpc_ros.ros.preflight.finding import Level

    namespace = checked_namespace(options.namespace)
    bridge = options.bridge
    if bridge not in ("", _NONE):
        bridge = str(load_bridge(bridge).name)
    stated = _stated(options.config)
    with RunningVehicle(namespace) as vehicle:
        facts = vehicle.facts(bridge=bridge, timeout=options.timeout)
    found = findings(facts.changed(stated=stated))
    rows = [(each.level.name.lower(), name, each.text) for name, each in found]
    print("\n".join(text_table(rows, align="lll")))
    levels = [each.level for _, each in found]
    errors, warnings = levels.count(Level.ERROR), levels.count(Level.WARNING)
    print(
        f"{errors} to fix before the flight, {warnings} to check: docs/howto/preflight.md"
        if errors
        else f"nothing to fix, {warnings} to check",
        file=sys.stderr,
    )
    return EXIT_FAILED if errors else 0


def _stated(sources: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return what files state for each node, validated. Raises :class:`UserError`."""
    if not sources:
        return {}
    from quad_mpc_ros.commands.running_vehicle import node_configurations
    from quad_mpc_ros.configuration import files

    schema = node_configurations()
    files.load(sources, [], schema=schema)
    return files.collected(sources, schema=schema)

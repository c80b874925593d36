"""``quad_mpc preflight``: whether the running nodes of a vehicle are fit to fly."""

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
    """Add which vehicle to look at, and what it should be."""
    parser.description = (
        "Look at the running nodes of a vehicle before it flies, and print a line for each check: "
        "ok, or what to do (docs/howto/preflight.md). Nothing is changed or flown. Exit code 0 "
        "when it may fly, warnings allowed, 1 when something must be fixed, 2 for wrong input."
    )
    parser.add_argument(
        "--namespace", default="", metavar="NS", help="namespace of the vehicle (default: none)"
    )
    parser.add_argument(
        "--bridge",
        default="",
        metavar="NAME",
        help="bridge that must run, as px4, or none (default: whichever runs, or the simulator)",
    )
    add_config(parser, "that the nodes should have been given")
    parser.add_argument(
        "--timeout",
        type=float,
        default=10.0,
        metavar="S",
        help="how long to wait for nodes, their answers and odometry (default: 10)",
    )


def run(options: argparse.Namespace) -> int:
    """Look, judge, print; return the exit code."""
    if not _MIN_TIMEOUT <= options.timeout < float("inf"):
        raise UserError(f"--timeout: given {options.timeout}, expected {_MIN_TIMEOUT:g} or more")
    require_ros("preflight", instead="; 'simulate' and 'campaign' rehearse without it")
    from quad_mpc_ros.commands.observer import checked_namespace
    from quad_mpc_ros.commands.running_vehicle import RunningVehicle
    from quad_mpc_ros.ros.preflight.checks import findings
    from quad_mpc_ros.ros.preflight.finding import Level

    namespace = checked_namespace(options.namespace)
    bridge = _bridge(options.bridge)
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


def _bridge(name: str) -> str:
    """Return the name of the bridge's node. Raises :class:`UserError` for an unknown one."""
    from quad_mpc_ros.ros.bridges.registry import load_bridge

    return name if name in ("", _NONE) else str(load_bridge(name).name)


def _stated(sources: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return what files state for each node, validated. Raises :class:`UserError`."""
    if not sources:
        return {}
    from quad_mpc_ros.commands.running_vehicle import node_configurations
    from quad_mpc_ros.configuration import files

    schema = node_configurations()
    files.load(sources, [], schema=schema)
    return files.collected(sources, [], schema=schema)

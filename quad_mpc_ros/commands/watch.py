"""``quad_mpc watch``: the status of flying vehicles in the terminal."""

from __future__ import annotations

import argparse

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.processes import require_ros


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what to watch, and how."""
    parser.description = (
        "Print the active source, the tracking error, ages, counters and estimates each "
        "second in a table with a column for each vehicle, and below it the nodes that report a "
        "warning or an error. Ctrl-C ends it. Exit code 1 if --once had nothing to show."
    )
    parser.add_argument(
        "--namespace",
        action="append",
        metavar="NAME",
        help="a vehicle to watch, / for the one without a namespace; may be repeated (default: "
        "all that are found)",
    )
    parser.add_argument("--once", action="store_true", help="print one table and exit")


def run(options: argparse.Namespace) -> int:
    """Watch until Ctrl-C, or once. Raises :class:`UserError` if ROS is missing."""
    require_ros("watch")
    from quad_mpc_ros.commands.watched_vehicles import watch, watch_once

    if options.once:
        return 0 if watch_once(options.namespace) else EXIT_FAILED
    watch(options.namespace)
    return 0

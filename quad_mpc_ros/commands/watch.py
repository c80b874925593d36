# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc watch``: print the status of flying vehicles."""

from __future__ import annotations

import argparse

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.processes import require_ros


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the namespaces and the mode."""
    parser.description = (
        "Print the active source, the tracking error, ages, counters and estimates each second "
        "in a table with a column for each vehicle, and below it the nodes that report a warning "
        "or an error. Stop with Ctrl-C. Exit code 1 if --once found no vehicle."
    )
    parser.add_argument(
        "--namespace",
        action="append",
        metavar="NAME",
        help="namespace of a vehicle, / for a vehicle without one; may be repeated (default: all "
        "vehicles)",
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

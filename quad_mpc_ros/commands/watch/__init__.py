"""``quad_mpc watch``: the status of flying vehicles in the terminal."""

from __future__ import annotations

import argparse
import importlib

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.processes import require_ros
from quad_mpc_ros.configuration import UserError

_RICH_NEEDED = "quad_mpc watch draws with Rich: apt install python3-rich, or pip install rich"
_TERMINAL_INTERVAL, _PLAIN_INTERVAL = 0.25, 1.0  # s


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what to watch, and how."""
    parser.description = (
        "Show the active source and the reason, the tracking error, estimates, ages, rates and "
        "counters in a table with a column for each vehicle. Without a terminal, the table is "
        "printed as plain text, once each interval. Ctrl-C ends it. Exit code 1 if there was "
        "nothing to show, 2 for bad input."
    )
    parser.add_argument(
        "--namespace",
        action="append",
        metavar="NAME",
        help="a vehicle to watch, / for the one without a namespace; may be repeated (default: "
        "all that are found)",
    )
    parser.add_argument("--once", action="store_true", help="print one table and exit")
    parser.add_argument(
        "--interval",
        type=float,
        metavar="S",
        help=f"time between two tables (default: {_TERMINAL_INTERVAL:g}, without a terminal "
        f"{_PLAIN_INTERVAL:g})",
    )


def run(options: argparse.Namespace) -> int:
    """Watch until Ctrl-C, or once. Raises :class:`UserError` if Rich or ROS is missing."""
    interval = options.interval
    if interval is not None and not 0.01 <= interval <= 1000.0:
        raise UserError(f"--interval: given {interval:g}, expected a number from 0.01 to 1000")
    try:
        importlib.import_module("rich")
    except ImportError as error:
        raise UserError(f"{error}. {_RICH_NEEDED}") from error
    require_ros("watch")
    from quad_mpc_ros.commands.watch.live import watch_live, watch_once
    from quad_mpc_ros.commands.watch.screen import Screen

    if options.once:
        return 0 if watch_once(options.namespace) else EXIT_FAILED
    with Screen() as screen:
        default = _TERMINAL_INTERVAL if screen.is_terminal else _PLAIN_INTERVAL
        watch_live(screen, namespaces=options.namespace, interval=interval or default)
    return 0

"""``quad_mpc watch``: a status panel of flying vehicles in the terminal, or of a recorded bag."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.configuration import UserError

_RICH_NEEDED = "quad_mpc watch draws with Rich: apt install python3-rich, or pip install rich"
_QUICK, _PLAIN = 0.25, 1.0  # s between two pictures: in a terminal, and elsewhere


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what to watch, and how."""
    parser.description = (
        "Show who commands and why, the tracking error, what was learned, ages, rates and "
        "counters: of one vehicle on a panel, of several in a table. Without a terminal it "
        "prints plain text, once each interval. Ctrl-C ends it. Exit code 1 if there was nothing "
        "to show, 2 for bad input."
    )
    parser.add_argument(
        "--namespace",
        action="append",
        metavar="NAME",
        help="a vehicle to watch, / for the one without a namespace; may be repeated (default: "
        "all that are found)",
    )
    parser.add_argument(
        "--bag", type=Path, metavar="DIR", help="show a recorded bag instead, without ROS"
    )
    parser.add_argument(
        "--rate",
        type=float,
        default=None,
        metavar="X",
        help="of a bag: how many times faster than it was recorded (default: 1)",
    )
    parser.add_argument(
        "--once", action="store_true", help="print one picture, of a bag its end, and exit"
    )
    parser.add_argument(
        "--interval",
        type=float,
        default=None,
        metavar="S",
        help=f"time between two pictures (default: {_QUICK:g}, without a terminal {_PLAIN:g})",
    )


def run(options: argparse.Namespace) -> int:
    """Watch until the end of the bag or Ctrl-C."""
    for name, value in (("--rate", options.rate), ("--interval", options.interval)):
        if value is not None and not 0.01 <= value <= 1000.0:
            raise UserError(f"{name}: given {value:g}, expected a number from 0.01 to 1000")
    if options.rate is not None and options.bag is None:
        raise UserError("--rate is of a bag: given without --bag")
    rate = 1.0 if options.rate is None else options.rate
    try:
        importlib.import_module("rich")
    except ImportError as error:
        raise UserError(f"{error}. {_RICH_NEEDED}") from error
    from quad_mpc_ros.commands.watch.screen import Screen

    screen = Screen(once=options.once)
    interval = options.interval or (_QUICK if screen.is_terminal else _PLAIN)
    try:
        if options.bag is not None:
            from quad_mpc_ros.commands.watch.recorded import watch_bag

            seen = watch_bag(
                options.bag, screen, namespaces=options.namespace, rate=rate, interval=interval
            )
        else:
            from quad_mpc_ros.commands.processes import require_ros

            require_ros("watch", instead="; --bag shows a recorded one")
            from quad_mpc_ros.commands.watch.live import watch_live

            seen = watch_live(screen, namespaces=options.namespace, interval=interval)
    except KeyboardInterrupt:
        return 0
    return 0 if seen else EXIT_FAILED

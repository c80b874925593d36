"""The command line ``quad_mpc``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from quad_mpc_ros import __version__
from quad_mpc_ros.commands import (
    bag,
    bench,
    bridges,
    check_reference,
    fly,
    identify,
    params,
    replay,
    report,
    resolve,
    save_vehicle,
    simulate,
)
from quad_mpc_ros.commands.command import EXIT_BAD_INPUT, EXIT_INTERRUPTED
from quad_mpc_ros.commands.soak import command as soak
from quad_mpc_ros.configuration import UserError

COMMANDS = tuple(
    module.COMMAND
    for module in (
        fly,
        simulate,
        check_reference,
        report,
        identify,
        save_vehicle,
        resolve,
        replay,
        bag,
        params,
        bridges,
        soak,
        bench,
    )
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 failsafe or failure, 2 bad input."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    options = _parser(given).parse_args(given)
    try:
        return int(options.run(options))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser, with the options of the command that is asked for.

    Those of the others are left out: they name trajectories and plants, whose import takes time.
    """
    parser = argparse.ArgumentParser(
        prog="quad_mpc",
        description="Model predictive control of a quadrotor on SO(3).",
        epilog="Every command explains itself: quad_mpc COMMAND --help.",
    )
    parser.add_argument("--version", action="version", version=f"quad_mpc {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        subparser = commands.add_parser(
            command.name, help=command.help, description=command.description
        )
        if command.name in arguments:
            command.add_options(subparser)
        subparser.set_defaults(run=command.run)
    return parser


if __name__ == "__main__":
    sys.exit(main())

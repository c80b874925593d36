"""The command line ``quad_mpc``."""

from __future__ import annotations

import argparse
import errno
import importlib
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from quad_mpc_ros import __version__
from quad_mpc_ros.commands import EXIT_BAD_INPUT, EXIT_BROKEN_PIPE, EXIT_INTERRUPTED
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.argument_parser import ArgumentParser

COMMANDS = {
    "fly": "fly over DDS: simulator, reference, mpc and recorder as separate processes",
    "simulate": "fly the same in one process without ROS, faster than real time",
    "watch": "show the status of flying vehicles in the terminal",
    "rehearse": "how wrong may the guess of a vehicle be? margins, and a verdict before it flies",
    "campaign": "fly many flights with parameters that vary, on every core or a cluster",
    "tune": "search controller parameters by campaigns, with Optuna: a Pareto front",
    "check-reference": "judge a reference before it is flown: throttle and body rates against the "
    "limits",
    "plan": "plan the race of least time through gates, for a vehicle",
    "preflight": "look at the running nodes before a flight: vehicle, limits, topics, odometry",
    "report": "show recorded runs on one page: path, errors, solver",
    "identify": "fit lags, delay, thrust and drag of the vehicle to a recorded flight",
    "save-vehicle": "save the thrust and lags that a flying controller has estimated as a "
    "parameter file",
    "resolve": "feed a recorded flight to the controller: what would it have commanded?",
    "replay": "publish a recorded bag again",
    "bag": "repair a bag",
    "params": "print every parameter: type, default, unit, range, whether live, meaning",
    "compile": "compile everything now, so that no node has to when it starts",
}
"""What each command does; the module of that name does it."""


_EXTRAS_PREFIX = "quad_mpc_ros.extras."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 failsafe or failure, 2 bad input."""
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()  # here, where a closed pipe is an exception that can be caught
    except BrokenPipeError:
        # What is still buffered goes nowhere, or the interpreter would complain at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE


def _run(arguments: Sequence[str] | None) -> int:
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        options, unknown = parser_for(given).parse_known_args(given)
        if unknown:
            options.refuse(f"given {' '.join(unknown)}, expected no such argument")
        with _interruptible():
            return int(options.run(options))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except ModuleNotFoundError as error:
        if not f"{error.name}.".startswith(_EXTRAS_PREFIX):
            raise
        print(f"error: {_missing_part(given, str(error.name))}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        print(f"error: {error.filename!s:.60}…: {error.strerror}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _missing_part(given: Sequence[str], module: str) -> str:
    return f"given {' '.join(given):.60}, needs the optional part {module}, not installed"


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let SIGINT raise ``KeyboardInterrupt`` where it would end the process, as at its start."""
    ends_process = signal.getsignal(signal.SIGINT) is signal.SIG_DFL
    try:
        if ends_process:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        yield
    finally:
        if ends_process:
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def parser_for(given: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser, with the options of the command that is given only.

    The parsers of the others take time to build: they name trajectories and plants.
    """
    parser = ArgumentParser(
        prog="quad_mpc",
        description="Model predictive control of a quadrotor on SO(3).",
        epilog="Every command explains itself: quad_mpc COMMAND --help.",
    )
    parser.add_argument("--version", action="version", version=f"quad_mpc {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, meaning in COMMANDS.items():
        subparser = commands.add_parser(name, help=meaning)
        if name in given:
            module = importlib.import_module(f"quad_mpc_ros.commands.{name.replace('-', '_')}")
            module.add_options(subparser)
            subparser.set_defaults(run=module.run, refuse=subparser.error)
    return parser


if __name__ == "__main__":
    sys.exit(main())

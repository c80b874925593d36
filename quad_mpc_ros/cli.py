# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
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
    "watch": "print the status of flying vehicles",
    "rehearse": "find the vehicle file errors that the MPC tolerates, before the first flight",
    "campaign": "simulate many flights with varied parameters, on all cores",
    "tune": "search controller parameters with Optuna: a Pareto front",
    "check-reference": "compare a reference with the limits of the vehicle",
    "plan": "plan a time-optimal race through gates",
    "preflight": "check the running nodes before a flight: vehicle, limits, topics, odometry",
    "report": "write an HTML page of recorded runs: path, errors, solver",
    "identify": "estimate lags, delay, thrust and drag of the vehicle from a recorded flight",
    "resolve": "recompute the commands of a recorded flight",
    "replay": "publish a recorded bag",
    "bag": "repair a bag",
    "params": "list all parameters: type, default, unit, range, live, meaning",
    "compile": "compile all code now, so that no node compiles when it starts",
}
"""The task of each command, which is in the module of the same name."""

_EXTRAS_PREFIX = "quad_mpc_ros.extras."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 failsafe or failure, 2 bad input."""
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()  # here, where a closed pipe is an exception that can be caught
    except BrokenPipeError:
        # Discard the buffer; otherwise the interpreter prints an error when it exits.
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
        needs = f"needs the optional part {error.name}, not installed"
        print(f"error: given {' '.join(given):.60}, {needs}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        print(f"error: {error.filename!s:.60}…: {error.strerror}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let SIGINT raise ``KeyboardInterrupt`` instead of ending the process."""
    ends_process = signal.getsignal(signal.SIGINT) is signal.SIG_DFL
    try:
        if ends_process:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        yield
    finally:
        if ends_process:
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def parser_for(given: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser, with the options of the given command only.

    The parsers of other commands are slow to build: some list trajectories and plants.
    """
    parser = ArgumentParser(
        prog="quad_mpc",
        description="Model predictive control of a quadrotor on SO(3).",
        epilog="Options of a command: quad_mpc COMMAND --help.",
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

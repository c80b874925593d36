"""What a command of ``quad_mpc`` is, and the exit codes with which it ends."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

EXIT_FAILED = 1
"""A flight with failsafe, a reference that cannot be flown, a soak that does not hold."""
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def no_options(_: argparse.ArgumentParser) -> None:
    """Add nothing."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command: what ``--help`` says, what it can be given, what it does.

    ``run`` returns the exit code. ``quad_mpc --help`` imports the module of every command, so
    these import at their top only what is quick: no NumPy, no ROS. The functions import the rest.
    """

    name: str
    help: str
    description: str
    run: Callable[[argparse.Namespace], int]
    add_options: Callable[[argparse.ArgumentParser], None] = no_options

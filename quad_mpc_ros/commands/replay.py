# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc replay``: the player node in this terminal."""

from __future__ import annotations

import argparse

from quad_mpc_ros.commands.processes import require_ros
from quad_mpc_ros.commands.recording import WHICH_BAG
from quad_mpc_ros.configuration import ConfigurationError, files
from quad_mpc_ros.recordings.config import PlayerConfig

_CLOCK_RATE = 40.0  # as ros2 bag play

# Options by the parameter of the player, where the names differ.
_OPTION_NAMES = {"bag": "BAG", "clock_rate": "--clock"}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options, with the defaults of the player node."""
    parser.description = (
        "Publish the messages of a bag on their topics, at the recorded times. player_node has "
        "more parameters: quad_mpc params player. Exit code 2 for a bag that cannot be played."
    )
    parser.add_argument("bag", metavar="BAG", help=WHICH_BAG)
    parser.add_argument("--rate", type=float, metavar="X", help="speed (default: 1)")
    parser.add_argument("--start", type=float, metavar="S", help="start S seconds into the bag")
    parser.add_argument(
        "--topics", nargs="+", metavar="TOPIC", help="publish only these topics (default: all)"
    )
    parser.add_argument(
        "--clock",
        nargs="?",
        type=float,
        const=_CLOCK_RATE,
        dest="clock_rate",
        metavar="HZ",
        help="publish the recorded time on /clock instead of a recorded /clock "
        f"(default: {_CLOCK_RATE:g} Hz)",
    )


def run(options: argparse.Namespace) -> int:
    """Play a bag until its end or Ctrl-C; return the exit code of the player."""
    given = {
        spec.name: value
        for spec in PlayerConfig.specs()
        if (value := getattr(options, spec.name, None)) is not None
    }
    try:
        PlayerConfig.build(given)
    except ConfigurationError as error:
        name = error.name.removeprefix("player.")
        option = _OPTION_NAMES.get(name, f"--{name}")
        raise ConfigurationError(option, error.given, error.expected) from error
    require_ros("replay")
    from quad_mpc_ros.ros.nodes.player_node import main

    arguments = ["--ros-args", "-p", "progress:=true"]
    for name, value in given.items():
        arguments += ["-p", f"{name}:={files.value_text(value)}"]
    return main(arguments)

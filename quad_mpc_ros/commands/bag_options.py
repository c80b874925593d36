"""Options of the commands on bags."""

from __future__ import annotations

import argparse
from pathlib import Path

_CLOCK_RATE = 40.0  # as ros2 bag play


def add_replay_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``replay``; those left out are the defaults of the player node."""
    parser.add_argument("bag", metavar="BAG", help="bag directory, or one .mcap file")
    parser.add_argument("--rate", type=float, metavar="X", help="speed (default: 1)")
    parser.add_argument(
        "--start", type=float, metavar="S", help="seconds into the bag to start at"
    )
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    parser.add_argument(
        "--topics", nargs="+", metavar="TOPIC", help="play these topics (default: all)"
    )
    parser.add_argument(
        "--regex",
        dest="topics_regex",
        metavar="REGEX",
        help="play topics in whose name this is found",
    )
    parser.add_argument(
        "--clock",
        nargs="?",
        type=float,
        const=_CLOCK_RATE,
        dest="clock_rate",
        metavar="HZ",
        help="publish the recorded time on /clock, in place of a recorded /clock "
        f"(default: {_CLOCK_RATE:g} Hz)",
    )
    parser.add_argument(
        "--delay",
        type=float,
        metavar="S",
        help="seconds before the first message, in which subscribers find the publishers "
        "(default: 1)",
    )
    parser.add_argument("--paused", action="store_true", help="start paused")
    parser.add_argument(
        "--remap",
        action="append",
        default=[],
        metavar="FROM:=TO",
        help="play a topic under another name; may be repeated",
    )


def add_bag_commands(parser: argparse.ArgumentParser) -> None:
    """Add what can be done with a bag directory."""
    commands = parser.add_subparsers(metavar="COMMAND", required=True, dest="command")
    info = commands.add_parser("info", help="what is in a bag: topics, counts, duration")
    info.add_argument("bag", type=Path, metavar="BAG", help="bag directory, or one .mcap file")
    repair = commands.add_parser(
        "repair",
        help="complete a recording that was cut short",
        description="Restore the index and metadata.yaml of a bag whose recorder was killed or "
        "lost its power. Damaged files stay beside the repaired ones as <name>.broken. A complete "
        "bag is left alone.",
    )
    repair.add_argument("bag", type=Path, metavar="DIR", help="bag directory")

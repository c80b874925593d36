# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc bag``: repair a bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from quad_mpc_ros.commands.recording import WHICH_BAG
from quad_mpc_ros.recordings.repair import RepairedFile, repair


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the repair of a bag directory."""
    parser.description = "Repair a bag; ros2 bag info lists its topics."
    commands = parser.add_subparsers(metavar="COMMAND", required=True, dest="command")
    repairing = commands.add_parser(
        "repair",
        help="complete an unfinished recording",
        description="Restore the index and metadata.yaml after the recorder was killed or lost "
        "power or after files were renamed. Damaged files are kept as <name>.broken. An intact "
        "bag is not changed.",
    )
    repairing.add_argument("bag", type=Path, metavar="BAG", help=WHICH_BAG)


def run(options: argparse.Namespace) -> int:
    """Repair the bag; return the exit code."""
    done = repair(options.bag)
    for file in done or ():
        print(_repaired(file))
    if done is None:
        print("nothing to repair")
    elif options.bag.is_dir():
        print("metadata.yaml written")
    return 0


def _repaired(file: RepairedFile) -> str:
    return (
        f"{file.path.name}: {file.message_count} messages kept, omitted {file.damaged_chunks} "
        f"damaged chunks; the original is {file.original.name}"
    )

"""Options of ``quad_mpc params``."""

from __future__ import annotations

import argparse


def add_params_options(parser: argparse.ArgumentParser) -> None:
    """Add them to its parser."""
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NODE[.PARAM]",
        help="a node, or a parameter or group of one: mpc, mpc.fence, simulator.wind "
        "(default: every node)",
    )
    parser.add_argument(
        "--format",
        choices=("text", "markdown", "yaml"),
        default="text",
        help="text to read; markdown, which docs/parameters.md is made of; yaml, a ROS parameter "
        "file with every default to edit (default: text)",
    )
    parser.add_argument(
        "--live",
        action="store_true",
        help="only those that may change in flight",
    )

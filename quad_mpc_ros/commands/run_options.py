# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that fly: configuration, duration, start, output."""

from __future__ import annotations

import argparse
from pathlib import Path

DEFAULT_DURATION = 10.0  # s, at least
SETTLING_TIME = 2.0  # s, after the end of a trajectory
DETOUR_SHARE = 1.25  # of its duration, with obstacles or where time may be given up


def add_configuration_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the configuration to a command."""
    from quad_mpc_ros.references.config import TRAJECTORIES

    add_config(
        parser, "(default, agile, paper, paper_rigid_body, rotorpy, betaflight, vehicles/…)"
    )
    parser.add_argument(
        "--reference",
        metavar="NAME",
        help=f"trajectory to fly: {', '.join(TRAJECTORIES)} (default: square)",
    )
    parser.add_argument(
        "--gates",
        metavar="FILE",
        help="file of gates, or shipped track (split_s, seven_gates). The flight leads through "
        "the gates, unless --reference selects another trajectory. The passages are evaluated. "
        "To fly a plan, add --set reference.file=race.csv",
    )
    add_set(parser, "set one parameter, for example mpc.horizon_steps=20")


def add_controller(parser: argparse.ArgumentParser) -> None:
    """Add ``--controller``, which is short for ``--set mpc.controller=NAME``."""
    parser.add_argument(
        "--controller",
        type="mpc.controller={}".format,
        action="append",
        default=[],
        dest="assignments",
        metavar="NAME",
        help="controller: mpc, geometric, px4, lqr, raptor, a name of another package, or "
        "module:Class, which is also searched in the working directory (default: mpc)",
    )


def add_config(parser: argparse.ArgumentParser, which: str = "") -> None:
    """Add ``--config``; ``which`` describes the files."""
    parser.add_argument(
        "--config",
        action="append",
        default=[],
        metavar="FILE",
        help=f"{f'ROS parameter file or preset {which}'.strip()}; may be repeated, later files "
        "override earlier ones",
    )


def add_set(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Add ``--set``; its values are ``assignments``."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NODE.PARAM=VALUE",
        dest="assignments",
        help=f"{meaning}; may be repeated",
    )


def add_out(parser: argparse.ArgumentParser, content: str, label: str) -> None:
    """Add ``--out``, the folder of ``content``; ``label`` is the end of its default name."""
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder for {content} (default: runs/<date-time>_{label})",
    )


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a run to a command."""
    add_configuration_options(parser)
    add_controller(parser)
    parser.add_argument(
        "--start",
        choices=("ground", "reference"),
        help="start on the ground (simulator.initial_*), or in motion on the reference; --set "
        "simulator.initial_*=VALUE overrides both (default: reference if the reference is smooth "
        "and starts at once, and no file sets simulator.initial_*; otherwise ground)",
    )
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help="duration of the flight in seconds (default: simulator.duration of a file, or one "
        f"lap of the reference and {SETTLING_TIME:g}, at least {DEFAULT_DURATION:g})",
    )
    parser.add_argument(
        "--obstacles",
        type=Path,
        metavar="FILE",
        help="fly among the boxes, cylinders and spheres of FILE: the mpc avoids the obstacles, "
        "and a collision is a crash (docs/howto/obstacles.md)",
    )
    parser.add_argument(
        "--sensor",
        choices=("rays", "markers"),
        help="publish the obstacles of FILE within simulator.obstacles.sensor_range (6 m) as "
        "points or shapes, and do not give FILE to the mpc (default: the mpc reads FILE; "
        "obstacles that move or appear later are published as shapes)",
    )
    add_out(parser, "bag, summary.json and figures; must not contain any yet", "<reference>")
    parser.set_defaults(plant=None)

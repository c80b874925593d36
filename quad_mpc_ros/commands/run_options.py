"""The options of the commands that fly: what is configured, how long, from where, into what."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from quad_mpc_ros.configuration import UserError

DEFAULT_DURATION = 10.0  # s, at least
SETTLING_TIME = 2.0  # s, after the end of a trajectory
CONTOURING_SHARE = 1.25  # of its duration, where time may be given up


def add_configuration_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is configured to a command."""
    from quad_mpc_ros.references.config import TRAJECTORIES

    add_config(
        parser, "(default, agile, paper, paper_rigid_body, rotorpy, betaflight, vehicles/…)"
    )
    parser.add_argument(
        "--reference",
        metavar="NAME",
        help=f"trajectory to fly: {', '.join(TRAJECTORIES)} (default: square)",
    )
    add_gates(parser)
    add_set(parser, "set one parameter, for example mpc.horizon_steps=20")


def add_gates(parser: argparse.ArgumentParser) -> None:
    """Add ``--gates``."""
    parser.add_argument(
        "--gates",
        metavar="FILE",
        help="course of gates, or the name of a shipped one (split_s, seven_gates): it is drawn "
        "and judged, and flown unless --reference says otherwise; along a plan with --set "
        "reference.file=race.csv",
    )


def add_config(parser: argparse.ArgumentParser, which: str = "") -> None:
    """Add ``--config``; ``which`` describes the files."""
    parser.add_argument(
        "--config",
        action="append",
        default=[],
        metavar="FILE",
        help=f"{f'ROS parameter file or preset {which}'.strip()}; may be repeated, later ones win",
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
    """Add ``--out``, the folder of ``content``; ``label`` ends the name that it has by default."""
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder for {content} (default: runs/<date-time>_{label})",
    )


def check_duration(seconds: float) -> None:
    """Raise :class:`UserError` unless ``--duration`` is a length of time."""
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise UserError(f"--duration: given {seconds}, expected a number > 0")


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a run to a command."""
    add_configuration_options(parser)
    parser.add_argument(
        "--start",
        choices=("ground", "reference"),
        help="where the flight begins: as simulator.initial_* say, which is on the ground, or in "
        "motion on the reference; --set simulator.initial_*=VALUE wins (default: reference where "
        "that is smooth and flown at once, but for what a file says of simulator.initial_*; else "
        "ground)",
    )
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help="length of the flight in seconds (default: simulator.duration of a file, or one lap "
        f"of the reference and {SETTLING_TIME:g}, at least {DEFAULT_DURATION:g})",
    )
    parser.add_argument(
        "--obstacles",
        type=Path,
        metavar="FILE",
        help="fly among the boxes, cylinders and spheres of FILE: the mpc keeps clear of them, "
        "and a vehicle that touches one has crashed (docs/howto/obstacles.md)",
    )
    parser.add_argument(
        "--sensor",
        choices=("rays", "markers"),
        help="the mpc does not know FILE, but sees what is within simulator.obstacles."
        "sensor_range, 6 m, as points or as shapes (default: it knows what stands, and sees "
        "what moves or appears as shapes)",
    )
    add_out(parser, "bag, summary.json and figures; must not hold any", "<reference>")
    parser.set_defaults(plant=None)

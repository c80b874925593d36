"""The options of the commands that write a vehicle's parameter file."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_save_vehicle_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``save-vehicle``."""
    parser.add_argument(
        "--node",
        default="/mpc",
        metavar="NAME",
        help="full name of the running MPC node, for example /uav1/mpc (default: /mpc)",
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=5.0,
        metavar="S",
        help="how long to watch what it estimates (default: 5)",
    )
    add_vehicle_file_options(parser)
    parser.add_argument(
        "--overwrite", action="store_true", help="let --out replace an existing file"
    )


def add_vehicle_file_options(parser: argparse.ArgumentParser) -> None:
    """Add where to write the file, and what it shall leave as it is."""
    parser.add_argument(
        "--keep",
        choices=("mass", "curve"),
        default="mass",
        help="what is believed of thrust per mass, of which a flight shows the quotient only: "
        "mass scales the thrust curve, curve the mass (default: mass)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="parameter file to write, instead of printing it"
    )

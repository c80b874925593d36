"""The options of ``report``; nothing is imported for them."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_report_options(parser: argparse.ArgumentParser) -> None:
    """Add the runs and where to write what is made of them."""
    parser.add_argument(
        "runs",
        type=Path,
        nargs="+",
        metavar="DIR",
        help="folder of a run with bag/ in it, bag directory, or .mcap file; several are shown "
        "beside each other",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("report.html"),
        metavar="FILE",
        help="page to write (default: report.html)",
    )
    parser.add_argument(
        "--png",
        type=Path,
        metavar="DIR",
        help="write the figures as PNG too, into a folder per run in DIR, and of several runs "
        "DIR/comparison.png",
    )
    parser.add_argument(
        "--csv",
        type=Path,
        metavar="DIR",
        help="write the time series as CSV too, into a folder per run in DIR: odometry.csv, "
        "commands.csv, ticks.csv",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace files that exist already"
    )

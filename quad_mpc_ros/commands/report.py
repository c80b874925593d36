"""``quad_mpc report``: recorded runs on one page, and their figures and time series as files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.output import check_writable, results_in, write_new

if TYPE_CHECKING:
    from quad_mpc_ros.report import ReportedRun

_COMPARISON = "comparison.png"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the runs and where to write what is made of them."""
    parser.description = (
        "Make a self-contained HTML page of one recorded run, or of several beside each "
        "other, with figures to zoom in and a table of the figures of merit. Needs Plotly: "
        "pip install 'quad_mpc_ros[report]'. Exit code 2 for a bag that cannot be used."
    )
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


def run(options: argparse.Namespace) -> int:
    """Read, draw, write, tell; return the exit code."""
    from quad_mpc_ros.report import csv_tables, page, read_runs

    bags = _named(options.runs)
    _check(options, list(bags))
    runs = read_runs(bags)
    write_new("--out", options.out, page(runs), overwrite=options.overwrite)
    print(f"report  {options.out}")
    if options.png is not None:
        with results_in(options.png):
            _write_figures(runs, options.png)
        print(f"figures {options.png}")
    if options.csv is not None:
        for run in runs:
            for name, text in csv_tables(run).items():
                path = options.csv / run.name / f"{name}.csv"
                write_new("--csv", path, text, overwrite=options.overwrite)
        print(f"series  {options.csv}")
    return 0


def _named(given: Sequence[Path]) -> dict[str, Path]:
    """Return the bags by the names of their runs, numbered where folders have the same name."""
    from quad_mpc_ros.recordings.bag_metadata import bag_of

    bags: dict[str, Path] = {}
    for path in given:
        bag = bag_of(path)
        whole = bag.resolve()
        name = whole.parent.name if whole.name == "bag" else whole.name
        numbered, number = name, 2
        while numbered in bags:
            numbered, number = f"{name}_{number}", number + 1
        bags[numbered] = bag
    return bags


def _check(options: argparse.Namespace, names: Sequence[str]) -> None:
    """Refuse, before anything is read, to write over what is there."""
    from quad_mpc_ros.figures import FIGURE_NAMES
    from quad_mpc_ros.report import TABLE_NAMES

    planned = [("--out", options.out)]
    for name in names:
        if options.png is not None:
            planned += [("--png", options.png / name / f"{each}.png") for each in FIGURE_NAMES]
        if options.csv is not None:
            planned += [("--csv", options.csv / name / f"{each}.csv") for each in TABLE_NAMES]
    if options.png is not None and len(names) > 1:
        planned.append(("--png", options.png / _COMPARISON))
    for option, path in planned:
        check_writable(option, path, overwrite=options.overwrite)


def _write_figures(runs: Sequence[ReportedRun], folder: Path) -> None:
    from quad_mpc_ros.figures import write_comparison, write_figures

    for run in runs:
        write_figures(run.flight, folder / run.name)
    if len(runs) > 1:
        write_comparison({run.name: run.flight for run in runs}, folder / _COMPARISON)

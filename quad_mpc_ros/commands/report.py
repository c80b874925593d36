"""``quad_mpc report``: recorded runs on one page, and their series as files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from quad_mpc_ros.commands.output import check_writable, write_new
from quad_mpc_ros.configuration import UserError


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the runs and where to write what is made of them."""
    parser.description = (
        "Make a self-contained HTML page of one recorded run, or of several beside each "
        "other, with figures to zoom in and a table of the figures of merit. "
        "Needs Plotly: pip install 'quad_mpc_ros[report]'. Exit code 2 for what cannot be used."
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
        "--csv",
        type=Path,
        metavar="DIR",
        help="write the time series of runs as CSV too, into a folder per run in DIR: "
        "odometry.csv, commands.csv, ticks.csv",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace files that exist already"
    )


def run(options: argparse.Namespace) -> int:
    """Read, draw and write; return the exit code."""
    from quad_mpc_ros.analysis.report import csv_tables, page, read_runs

    bags = _named(options.runs)
    _check(options, list(bags))
    runs = read_runs(bags)
    write_new("--out", options.out, page(runs), overwrite=options.overwrite)
    for run in runs:
        if run.warning:
            print(f"warning: {run.warning}", file=sys.stderr)
        print(f"{run.name}: {run.verdict.line}")
        print("\n".join(f"  to do: {each}" for each in run.verdict.advice))
    print(f"report  {options.out}")
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
        if (path / "campaign.yaml").is_file():
            raise UserError(
                f"DIR: given the campaign {path}, expected a run; look at {path}/campaign.png, or "
                f"make a run of a flight: quad_mpc simulate --config {path}/flights/NUMBER.yaml"
            )
        bag = bag_of(path)
        whole = bag.resolve()
        name = numbered = whole.parent.name if whole.name == "bag" else whole.name
        number = 2
        while numbered in bags:
            numbered, number = f"{name}_{number}", number + 1
        bags[numbered] = bag
    return bags


def _check(options: argparse.Namespace, names: Sequence[str]) -> None:
    """Refuse, before anything is read, to write over what is there."""
    from quad_mpc_ros.analysis.report import TABLE_NAMES

    planned = [("--out", options.out)]
    for name in names:
        if options.csv is not None:
            planned += [("--csv", options.csv / name / f"{each}.csv") for each in TABLE_NAMES]
    for option, path in planned:
        check_writable(option, path, overwrite=options.overwrite)

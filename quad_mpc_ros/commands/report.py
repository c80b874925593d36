# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc report``: an HTML page of recorded runs, and their time series as CSV."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from quad_mpc_ros.commands.output import check_writable, results_in, write_new
from quad_mpc_ros.configuration import UserError


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the runs and the outputs."""
    parser.description = (
        "Write a self-contained HTML page of one recorded run, or of several next to each other: "
        "summary, metrics, parameters, figures."
    )
    parser.add_argument(
        "runs",
        type=Path,
        nargs="+",
        metavar="DIR",
        help="folder of a run with bag/ in it, bag directory, or .mcap file",
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
        help="write odometry.csv, commands.csv and ticks.csv of each run into a folder in DIR",
    )
    parser.add_argument(
        "--format",
        choices=("pdf", "svg", "png"),
        help="also write the figures as files into the folder <name of the page>_figures",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")


def run(options: argparse.Namespace) -> int:
    """Read, draw and write; return the exit code."""
    from quad_mpc_ros.analysis.report import csv_tables, page, read_runs, run_figures

    bags = _named(options.runs)
    _check(options, list(bags))
    runs = read_runs(bags)
    write_new("--out", options.out, page(runs), overwrite=options.overwrite)
    for run in runs:
        print(f"{run.name}: {run.verdict.line}")
        print("\n".join(f"  to do: {each}" for each in run.verdict.advice))
    print(f"report  {options.out}")
    if options.format is not None:
        with results_in(_figure_folder(options)):
            for _ in run_figures(runs, _figure_folder(options), options.format):
                pass
        print(f"figures {_figure_folder(options)}")
    if options.csv is not None:
        for run in runs:
            for name, text in csv_tables(run).items():
                path = options.csv / run.name / f"{name}.csv"
                write_new("--csv", path, text, overwrite=options.overwrite)
        print(f"series  {options.csv}")
    return 0


def _named(given: Sequence[Path]) -> dict[str, Path]:
    """Return the bags, keyed by run name, with numbers if folders have equal names."""
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


def _figure_folder(options: argparse.Namespace) -> Path:
    page: Path = options.out
    return page.with_name(f"{page.stem}_figures")


def _check(options: argparse.Namespace, names: Sequence[str]) -> None:
    """Reject existing output files before anything is read."""
    from quad_mpc_ros.analysis.report import TABLE_NAMES

    planned = [("--out", options.out)]
    for name in names:
        if options.format is not None:
            file = _figure_folder(options) / f"path_{name}.{options.format}"
            planned.append(("--format", file))
        if options.csv is not None:
            planned += [("--csv", options.csv / name / f"{each}.csv") for each in TABLE_NAMES]
    for option, path in planned:
        check_writable(option, path, overwrite=options.overwrite)

"""``quad_mpc report``: recorded runs, or campaigns, on one page; the series of runs as files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.output import check_writable, results_in, write_new
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.analysis.report import ReportedRun

_COMPARISON = "comparison.png"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the runs and where to write what is made of them."""
    parser.description = (
        "Make a self-contained HTML page of one recorded run, or of several beside each "
        "other, with figures to zoom in and a table of the figures of merit; or of campaigns, "
        "with what crashed and where, the distribution of every figure and the worst flights. "
        "Needs Plotly: pip install 'quad_mpc_ros[report]'. Exit code 2 for what cannot be used."
    )
    parser.add_argument(
        "runs",
        type=Path,
        nargs="+",
        metavar="DIR",
        help="folder of a run with bag/ in it, bag directory, or .mcap file; or folder of a "
        "campaign with flights.csv in it; several of a kind are shown beside each other",
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
        help="write the figures of runs as PNG too, into a folder per run in DIR, and of several "
        "runs DIR/comparison.png",
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
    from quad_mpc_ros.experiments.campaign_report import is_campaign

    campaigns = [path for path in options.runs if is_campaign(path)]
    if not campaigns:
        return _report_runs(options)
    others = [path for path in options.runs if path not in campaigns]
    if others:
        raise UserError(
            f"given campaigns ({_listed(campaigns)}) and runs ({_listed(others)}), expected one "
            "kind: make a page of each"
        )
    return _report_campaigns(options)


def _report_campaigns(options: argparse.Namespace) -> int:
    from quad_mpc_ros.experiments.campaign_report import campaign_page, read_campaigns

    first = options.runs[0]
    if options.csv is not None:
        raise UserError(
            f"--csv: given a campaign, expected runs; its table is {first / 'flights.csv'}"
        )
    if options.png is not None:
        raise UserError(
            "--png: given a campaign, expected runs; the page saves its figures, and "
            f"quad_mpc simulate --config {first}/flights/NUMBER.yaml makes the run of a flight"
        )
    check_writable("--out", options.out, overwrite=options.overwrite)
    folders: dict[str, Path] = {}
    for folder in options.runs:
        folders[_unique(folder.resolve().name, folders)] = folder
    text = campaign_page(read_campaigns(folders))
    write_new("--out", options.out, text, overwrite=options.overwrite)
    print(f"report  {options.out}")
    return 0


def _report_runs(options: argparse.Namespace) -> int:
    from quad_mpc_ros.analysis.report import csv_tables, page, read_runs

    bags = _named(options.runs)
    _check(options, list(bags))
    runs = read_runs(bags)
    write_new("--out", options.out, page(runs), overwrite=options.overwrite)
    for run in runs:
        if run.unfinished:
            print(f"warning: {run.unfinished}", file=sys.stderr)
        print(f"{run.name}: {run.verdict.line}")
        print("\n".join(f"  to do: {each}" for each in run.verdict.advice))
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
        bags[_unique(whole.parent.name if whole.name == "bag" else whole.name, bags)] = bag
    return bags


def _unique(name: str, taken: Collection[str]) -> str:
    numbered, number = name, 2
    while numbered in taken:
        numbered, number = f"{name}_{number}", number + 1
    return numbered


def _listed(paths: Sequence[Path]) -> str:
    return ", ".join(map(str, paths))


def _check(options: argparse.Namespace, names: Sequence[str]) -> None:
    """Refuse, before anything is read, to write over what is there."""
    from quad_mpc_ros.analysis.figures import FIGURE_NAMES
    from quad_mpc_ros.analysis.report import TABLE_NAMES

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
    from quad_mpc_ros.analysis.figures import write_comparison, write_figures

    for run in runs:
        write_figures(run.flight, folder / run.name)
    if len(runs) > 1:
        write_comparison({run.name: run.flight for run in runs}, folder / _COMPARISON)

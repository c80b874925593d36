# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc report``: an HTML page of recorded runs."""

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
        "--format",
        choices=("pdf", "svg", "png"),
        help="also write the figures as files into the folder <name of the page>_figures",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")


def run(options: argparse.Namespace) -> int:
    """Read, draw and write; return the exit code."""
    from quad_mpc_ros.analysis.report import page, read_runs, run_figures

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
    check_writable("--out", options.out, overwrite=options.overwrite)
    for name in names if options.format is not None else ():
        file = _figure_folder(options) / f"path_{name}.{options.format}"
        check_writable("--format", file, overwrite=options.overwrite)

"""``quad_mpc report``: recorded runs on one page, and their figures and time series as files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from quad_mpc_ros.atomic_file import write_atomically
from quad_mpc_ros.commands.recording import bag_of
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.figures.comparison import write_comparison
from quad_mpc_ros.figures.flight_figures import FIGURE_NAMES, write_figures
from quad_mpc_ros.report import TABLE_NAMES, ReportedRun, csv_tables, page, read_runs

_COMPARISON = "comparison.png"


def report(options: argparse.Namespace) -> int:
    """Read, draw, write, tell; return the exit code."""
    bags = _named(options.runs)
    _check(options, list(bags))
    runs = read_runs(bags)
    text = page(runs)
    try:
        _replace(options.out, text)
        print(f"report  {options.out}")
        if options.png is not None:
            _write_figures(runs, options.png)
            print(f"figures {options.png}")
        if options.csv is not None:
            _write_tables(runs, options.csv)
            print(f"series  {options.csv}")
    except OSError as error:
        raise UserError(f"{error.filename}: cannot be written: {error.strerror}") from error
    return 0


def _named(given: Sequence[Path]) -> dict[str, Path]:
    """Return the bags by the names of their runs, numbered where folders have the same name."""
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
    if options.out.is_dir():
        raise UserError(f"--out: {options.out} is a folder, expected the name of a page")
    if options.overwrite:
        return
    planned = [("--out", options.out)]
    for name in names:
        if options.png is not None:
            planned += [("--png", options.png / name / f"{each}.png") for each in FIGURE_NAMES]
        if options.csv is not None:
            planned += [("--csv", options.csv / name / f"{each}.csv") for each in TABLE_NAMES]
    if options.png is not None and len(names) > 1:
        planned.append(("--png", options.png / _COMPARISON))
    for option, path in planned:
        if path.exists():
            raise UserError(
                f"{option}: {path} exists and is not overwritten; give another name or --overwrite"
            )


def _write_figures(runs: Sequence[ReportedRun], folder: Path) -> None:
    for run in runs:
        write_figures(run.flight, folder / run.name)
    if len(runs) > 1:
        write_comparison({run.name: run.flight for run in runs}, folder / _COMPARISON)


def _write_tables(runs: Sequence[ReportedRun], folder: Path) -> None:
    for run in runs:
        for name, text in csv_tables(run).items():
            _replace(folder / run.name / f"{name}.csv", text)


def _replace(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text)

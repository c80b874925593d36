# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The results of a study: table, parameter files, figure, and a text for the terminal."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.extras.campaigns.campaign import number_text
from quad_mpc_ros.extras.campaigns.campaign_file import campaign_text
from quad_mpc_ros.extras.campaigns.journal import csv_text
from quad_mpc_ros.extras.campaigns.tuning.objectives import (
    FLOWN,
    GIVEN_UP,
    REFUSED,
    Objective,
    Trial,
    chosen,
    front_of,
)
from quad_mpc_ros.extras.campaigns.tuning.optimiser import NAME as STUDY_NAME
from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning, read_tuning, tuning_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAX_COLUMNS = 3
_WIDTH, _HEIGHT, _LEGEND_HEIGHT = 4.4, 3.8, 0.6  # inch
_LOG_SCALE_RATIO = 4.0  # of the largest to the smallest value
TUNE_NAME, CAMPAIGNS_NAME = "tune.yaml", "campaigns"
TRIALS_NAME, FIGURE_NAME = "trials.csv", "front.png"
FRONT_NAME, BEST_NAME = "front", "best.yaml"
HOLDS = (
    *(TUNE_NAME, CAMPAIGNS_NAME, STUDY_NAME),
    *(TRIALS_NAME, FIGURE_NAME, FRONT_NAME, BEST_NAME),
)
"""Content of a study's folder, which a new folder must not have."""

_CHECK_FLIGHTS = 200
_MAX_LISTED = 20


def write_front(
    path: Path,
    *,
    trials: Sequence[Trial],
    front: Sequence[Trial],
    best: Trial,
    objectives: Sequence[Objective],
) -> None:
    """Draw all trials, the front, the first and the chosen trial as PNG.

    A single objective is drawn over the number of the trial. Raises ``OSError``.
    """
    names = ["trial", *(objective.name for objective in objectives)]
    pairs = list(itertools.combinations(range(1, len(names)), 2)) or [(0, 1)]
    columns = min(len(pairs), _MAX_COLUMNS)
    lines = -(-len(pairs) // columns)
    height = _HEIGHT * lines + _LEGEND_HEIGHT
    figure = style.new_figure(_WIDTH * columns, height)
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 1.0 - _LEGEND_HEIGHT / height))
    for place, (across, up) in enumerate(pairs, start=1):
        axes = figure.add_subplot(lines, columns, place)
        _draw_trials(axes, (across, up), trials, front, best)
        axes.set_xlabel(names[across], fontsize=8, color=style.INK)
        axes.set_ylabel(names[up], fontsize=8, color=style.INK)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=3, frameon=False, fontsize=8)
    style.save(figure, path)


def _draw_trials(
    axes: Axes,
    pair: tuple[int, int],
    trials: Sequence[Trial],
    front: Sequence[Trial],
    best: Trial,
) -> None:
    """Draw the trials at two of their values; numbers on the front are those of the files."""
    style.tidy(axes)
    axes.margins(0.05)
    for label, marker, size, colour, group in (
        (GIVEN_UP, "x", 4, style.FAINT, [each for each in trials if each.outcome == GIVEN_UP]),
        (FLOWN, "o", 4, style.FAINT, [each for each in trials if each.outcome == FLOWN]),
        ("front", "o", 5, style.FLOWN, front),
        ("trial 0, the start", "D", 6, style.REFERENCE, trials[:1]),
        (f"trial {best.number}, chosen", "*", 12, style.BOUND, [best]),
    ):
        points = np.reshape([_values(trial, pair) for trial in group], (-1, 2))
        axes.plot(*points.T, marker, color=colour, markersize=size, label=label)
    for trial in front:
        axes.annotate(
            str(trial.number),
            _values(trial, pair),
            xytext=(4, 4),
            textcoords="offset points",
            fontsize=6,
            color=style.INK,
        )
    shown = np.array([_values(trial, pair) for trial in trials if trial.objectives])
    for name, values in zip("xy", shown.T, strict=True):
        if 0.0 < _LOG_SCALE_RATIO * values.min() < values.max():
            style.use_log_scale(axes, name)


def _values(trial: Trial, pair: tuple[int, int]) -> tuple[float, float]:
    """Return two values of a trial: 0 is its number, the others are its objectives."""
    values = (float(trial.number), *trial.objectives)
    return values[pair[0]], values[pair[1]]


@dataclass(frozen=True, kw_only=True)
class Results:
    """A study and its best trials.

    Attributes:
        tuning: The study.
        trials: All trials.
        front: Trials on the Pareto front.
        best: The chosen trial.
    """

    tuning: Tuning
    trials: Sequence[Trial]
    front: Sequence[Trial]
    best: Trial


def begin(tuning: Tuning, folder: Path) -> None:
    """Write a study into its empty folder. Raises ``OSError``."""
    (folder / CAMPAIGNS_NAME).mkdir()
    for name, campaign in tuning.campaigns.items():
        write_atomically(folder / CAMPAIGNS_NAME / f"{name}.yaml", campaign_text(campaign))
    write_atomically(folder / TUNE_NAME, tuning_text(tuning))


def tuning_of(folder: Path) -> Tuning:
    """Return the study in a folder. Raises :class:`UserError` without a study."""
    if not (folder / TUNE_NAME).is_file():
        raise UserError(f"{folder}: not the folder of a study: it has no {TUNE_NAME}")
    return read_tuning(folder / TUNE_NAME)


def results_of(tuning: Tuning, trials: Sequence[Trial]) -> Results:
    """Return the front and the best trial of a study."""
    front = front_of(trials)
    best = chosen(front, tuning.objectives)
    return Results(tuning=tuning, trials=trials, front=front, best=best)


def write_results(folder: Path, results: Results) -> None:
    """Write the results of a study, replacing earlier ones. Raises ``OSError``."""
    front = folder / FRONT_NAME
    front.mkdir(exist_ok=True)
    for old in front.glob("*.yaml"):
        old.unlink()
    for trial in results.front:
        name = f"{number_text(trial.number, len(results.trials))}.yaml"
        write_atomically(front / name, _parameter_file(results.tuning, trial))
    write_atomically(folder / BEST_NAME, _parameter_file(results.tuning, results.best))
    write_atomically(folder / TRIALS_NAME, _table(results))
    write_front(
        folder / FIGURE_NAME,
        trials=results.trials,
        front=results.front,
        best=results.best,
        objectives=results.tuning.objectives,
    )


def results_text(folder: Path, results: Results) -> str:
    """Return the first trial, the front, the chosen trial, and the command to test it."""
    trials, front, best = results.trials, results.front, results.best
    counts = ", ".join(
        f"{sum(trial.outcome == outcome for trial in trials)} {outcome}"
        for outcome in (FLOWN, GIVEN_UP, REFUSED)
    )
    names = [objective.name for objective in results.tuning.objectives]
    rows = [["", "trial", *names], ["start", "0", *_shown(trials[0])], []]
    rows += [
        ["chosen" if trial is best else "", str(trial.number), *_shown(trial)]
        for trial in front[:_MAX_LISTED]
    ]
    lines = [f"{len(trials)} trials: {counts}; {len(front)} on the front", ""]
    if trials[0].reason:
        lines[:0] = [f"trial 0 is {trials[0].reason}"]
    lines += text_table(rows, align="lr" + "r" * len(names))
    if len(front) > _MAX_LISTED:
        lines.append(f"… and {len(front) - _MAX_LISTED} more in {folder / TRIALS_NAME}")
    parameters = results.tuning.space().parameters(best.values)
    lines += [
        "",
        *(f"{name}: {files.value_text(value)}" for name, value in parameters.items()),
        "",
    ]
    lines += [
        f"chosen   {folder / BEST_NAME}",
        f"others   {folder / FRONT_NAME}/NUMBER.yaml",
        f"table    {folder / TRIALS_NAME}",
        f"picture  {folder / FIGURE_NAME}",
        "test the result with other vehicles:",
        f"  {_check(folder, results.tuning)}",
    ]
    return "\n".join(lines)


def _check(folder: Path, tuning: Tuning) -> str:
    name = tuning.objectives[0].campaign
    campaign = tuning.campaigns[name]
    more = f" --flights {_CHECK_FLIGHTS}" if campaign.vary else ""
    return (
        f"quad_mpc campaign {folder / CAMPAIGNS_NAME / name}.yaml --config {folder / BEST_NAME} "
        f"--seed {campaign.seed + 1}{more} --out {folder / 'check'}"
    )


def _shown(trial: Trial) -> list[str]:
    return [f"{value:.4g}" for value in trial.objectives]


def _parameter_file(tuning: Tuning, trial: Trial) -> str:
    """Return the searched parameters of a trial as a ROS parameter file."""
    comments = [
        f"# {objective.name}: {value:.6g}"
        for objective, value in zip(tuning.objectives, trial.objectives, strict=True)
    ]
    parameters = tuning.space().parameters(trial.values)
    lines = [f"    {name}: {files.value_text(value)}" for name, value in parameters.items()]
    return "\n".join(
        [f"# trial {trial.number}", *comments, "mpc:", "  ros__parameters:", *lines, ""]
    )


def _table(results: Results) -> str:
    """Return all trials as CSV: number, outcome, searched values, objectives, effort."""
    space = results.tuning.space()
    names = [objective.name for objective in results.tuning.objectives]
    columns = ["trial", "outcome", "on_front", *space.cells(results.trials[0].values), *names]
    rows = [
        {
            "trial": trial.number,
            "outcome": trial.outcome,
            "on_front": any(trial is each for each in results.front),
            **space.cells(trial.values),
            **dict(zip(names, trial.objectives, strict=False)),  # none if refused
            "flights": trial.flights,
            "lost": trial.lost,
            "seconds": f"{trial.seconds:.1f}",
            "reason": trial.reason,
        }
        for trial in results.trials
    ]
    return csv_text(rows, [*columns, "flights", "lost", "seconds", "reason"])

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The results of a study: table, parameter file, and a text for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.extras.campaigns.campaign_file import campaign_text
from quad_mpc_ros.extras.campaigns.table import csv_text
from quad_mpc_ros.extras.campaigns.tuning.objectives import (
    FLOWN,
    GIVEN_UP,
    REFUSED,
    Trial,
    chosen,
    front_of,
)
from quad_mpc_ros.extras.campaigns.tuning.study import NAME as STUDY_NAME
from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning, read_tuning

TUNE_NAME, CAMPAIGNS_NAME = "tune.yaml", "campaigns"
TRIALS_NAME, BEST_NAME = "trials.csv", "best.yaml"
HOLDS = (TUNE_NAME, CAMPAIGNS_NAME, STUDY_NAME, TRIALS_NAME, BEST_NAME)
"""Content of a study's folder, which a new folder must not have."""

_CHECK_FLIGHTS = 200
_MAX_LISTED = 20


def begin(tuning: Tuning, folder: Path) -> None:
    """Write a study into its empty folder. Raises ``OSError``."""
    (folder / CAMPAIGNS_NAME).mkdir()
    for name, campaign in tuning.campaigns.items():
        write_atomically(folder / CAMPAIGNS_NAME / f"{name}.yaml", campaign_text(campaign))
    write_atomically(folder / TUNE_NAME, tuning.text())


def tuning_of(folder: Path) -> Tuning:
    """Return the study in a folder. Raises :class:`UserError` without a study."""
    if not (folder / TUNE_NAME).is_file():
        raise UserError(f"{folder}: expected the folder of a study; {TUNE_NAME} is missing")
    return read_tuning(folder / TUNE_NAME)


def write_results(folder: Path, tuning: Tuning, trials: Sequence[Trial]) -> None:
    """Write the results of a study, replacing earlier ones. Raises ``OSError``."""
    best = chosen(front_of(trials), tuning.objectives)
    write_atomically(folder / BEST_NAME, _parameter_file(tuning, best))
    write_atomically(folder / TRIALS_NAME, _table(tuning, trials))


def results_text(folder: Path, tuning: Tuning, trials: Sequence[Trial]) -> str:
    """Return the first trial, the front, the chosen trial, and the command to test it."""
    front = front_of(trials)
    best = chosen(front, tuning.objectives)
    counts = ", ".join(
        f"{sum(trial.outcome == outcome for trial in trials)} {outcome}"
        for outcome in (FLOWN, GIVEN_UP, REFUSED)
    )
    names = [objective.name for objective in tuning.objectives]
    rows = [["", "trial", *names], ["start", "0", *_shown(trials[0])], []]
    rows += [
        ["chosen" if trial is best else "", str(trial.number), *_shown(trial)]
        for trial in front[:_MAX_LISTED]
    ]
    lines = [f"{len(trials)} trials: {counts}; {len(front)} on the front", ""]
    lines += text_table(rows, align="lr" + "r" * len(names))
    if len(front) > _MAX_LISTED:
        lines.append(f"… and {len(front) - _MAX_LISTED} more in {folder / TRIALS_NAME}")
    parameters = tuning.parameters(best.values)
    lines += [
        "",
        *(f"{name}: {files.value_text(value)}" for name, value in parameters.items()),
        "",
    ]
    lines += [
        f"chosen   {folder / BEST_NAME}",
        f"table    {folder / TRIALS_NAME}",
        "test the result with other vehicles:",
        f"  {_check(folder, tuning)}",
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
    parameters = tuning.parameters(trial.values)
    lines = [f"    {name}: {files.value_text(value)}" for name, value in parameters.items()]
    return "\n".join(
        [f"# trial {trial.number}", *comments, "mpc:", "  ros__parameters:", *lines, ""]
    )


def _table(tuning: Tuning, trials: Sequence[Trial]) -> str:
    """Return all trials as CSV: number, outcome, searched values, objectives, effort."""
    front = front_of(trials)
    names = [objective.name for objective in tuning.objectives]
    columns = ["trial", "outcome", "on_front", *trials[0].values, *names]
    rows = [
        {
            "trial": trial.number,
            "outcome": trial.outcome,
            "on_front": any(trial is each for each in front),
            **trial.values,
            **dict(zip(names, trial.objectives, strict=False)),  # none if refused
            "flights": trial.flights,
            "lost": trial.lost,
            "seconds": f"{trial.seconds:.1f}",
            "reason": trial.reason,
        }
        for trial in trials
    ]
    return csv_text(rows, [*columns, "flights", "lost", "seconds", "reason"])

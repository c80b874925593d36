# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc tune``: search controller parameters with campaigns and an optimiser."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.campaign_options import add_campaign_options, engine_of
from quad_mpc_ros.commands.output import create_out, prepared_out, results_in
from quad_mpc_ros.commands.progress import ProgressLine
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.extras.campaigns.tuning.objectives import Trial
    from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Search controller parameters with campaigns of flights (docs/howto/tune.md). The first "
        "trial flies the configuration of the campaigns. Writes trials.csv and the parameter "
        "file best.yaml of the chosen trial. Exit code 0 if all trials were flown. Ctrl-C or a "
        "kill loses only the running trial. Needs Optuna: pip install 'quad_mpc_ros[campaign]'."
    )
    add_campaign_options(parser, "study")
    parser.add_argument(
        "--resume", type=Path, metavar="DIR", help="continue the study in a folder, without FILE"
    )
    parser.add_argument(
        "--trials", type=int, metavar="N", help="number of trials; overrides the file"
    )


def run(options: argparse.Namespace) -> int:
    """Fly the remaining trials, print the results, and return the exit code."""
    from quad_mpc_ros.extras.campaigns.tuning.study import Study, optuna_module
    from quad_mpc_ros.extras.campaigns.tuning.tune_results import (
        HOLDS,
        begin,
        results_text,
        write_results,
    )

    if options.trials is not None and options.trials < 1:
        raise UserError(f"--trials: given {options.trials}, expected a number >= 1")
    optuna_module()
    tuning = _tuning(options)
    trials = options.trials or tuning.trials
    tuning = dataclasses.replace(tuning, trials=trials)
    with engine_of(options) as engine:
        out: Path | None = options.resume
        if out is None:
            out = prepared_out(options.out or create_out(options.file.stem), holds=HOLDS)
            with results_in(out):
                begin(tuning, out)
        study = Study(out, tuning)
        print(f"{trials} trials with {engine.workers} workers into {out}", file=sys.stderr)
        progress = ProgressLine()
        flights = sum(campaign.flights for campaign in tuning.campaigns.values())

        def observe(finished: list[Trial], flown: int) -> None:
            trial = min(len(finished) + 1, trials)
            progress.show(f"trial {trial} of {trials}, {flown} of {flights} flights")

        try:
            study.run(engine, observe)
        except KeyboardInterrupt:
            print(f"\nto continue: quad_mpc tune --resume {out}", file=sys.stderr)
            raise
        finally:
            progress.close()
        done = study.trials()
        with results_in(out):
            write_results(out, tuning, done)
    print(results_text(out, tuning, done))
    return 0


def _tuning(options: argparse.Namespace) -> Tuning:
    """Return the requested study."""
    from quad_mpc_ros.extras.campaigns.campaign_file import Overrides, located_campaign
    from quad_mpc_ros.extras.campaigns.tuning.tune_file import read_tuning
    from quad_mpc_ros.extras.campaigns.tuning.tune_results import tuning_of

    if options.resume is not None:
        if any((options.file, options.out, options.config, options.assignments)):
            raise UserError(
                f"--resume: the study in {options.resume} continues unchanged: omit FILE, --out "
                "and options that change the study"
            )
        return tuning_of(options.resume)
    if options.file is None:
        raise UserError("FILE: expected the file of a study, or --resume DIR")
    overrides = Overrides(config=options.config, assignments=options.assignments)
    return read_tuning(located_campaign(options.file), overrides)

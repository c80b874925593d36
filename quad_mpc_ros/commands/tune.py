# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc tune``: search controller parameters with campaigns and an optimiser."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import fcntl
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.campaign_options import (
    add_campaign_options,
    campaign_folder,
    engine_of,
    new_or_resumed,
)
from quad_mpc_ros.commands.progress import ProgressLine
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.extras.campaigns.tuning.objectives import Trial
    from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Search controller parameters with campaigns of flights (docs/howto/tune.md). The first "
        "trial flies the configuration of the campaigns. Writes trials.csv, the picture "
        "front.png, and parameter files: front/NUMBER.yaml for each Pareto-optimal trial and "
        "best.yaml for the chosen one. Exit code 0 if all trials were flown. Ctrl-C or a kill "
        "loses only the running trial. Needs Optuna: pip install 'quad_mpc_ros[campaign]'."
    )
    add_campaign_options(parser, "study")
    parser.add_argument(
        "--trials", type=int, metavar="N", help="number of trials; overrides the file"
    )


def run(options: argparse.Namespace) -> int:
    """Fly the remaining trials, print the results, and return the exit code."""
    from quad_mpc_ros.extras.campaigns.tuning.optimiser import optuna_module
    from quad_mpc_ros.extras.campaigns.tuning.study import Study
    from quad_mpc_ros.extras.campaigns.tuning.tune_results import (
        HOLDS,
        TUNE_NAME,
        begin,
        results_of,
        results_text,
        write_results,
    )

    if options.trials is not None and options.trials < 1:
        raise UserError(f"--trials: given {options.trials}, expected a number >= 1")
    optuna_module()
    tuning = _tuning(options)
    trials = options.trials or tuning.trials
    tuning = dataclasses.replace(tuning, trials=trials)
    with (
        engine_of(options) as engine,
        campaign_folder(options, HOLDS) as out,
        contextlib.ExitStack() as held,
    ):
        if options.resume is None:
            begin(tuning, out)
        held.enter_context(_held(out / TUNE_NAME))
        study = Study(out, tuning)
        print(f"{trials} trials with {engine.workers} workers into {out}", file=sys.stderr)
        progress = ProgressLine()
        flights = sum(campaign.flights for campaign in tuning.campaigns.values())

        def observe(done: list[Trial], flown: int) -> None:
            trial = min(len(done) + 1, trials)
            progress.show(f"trial {trial} of {trials}, {flown} of {flights} flights")

        try:
            study.run(engine, observe)
        except KeyboardInterrupt:
            print(f"\nto continue: quad_mpc tune --resume {out}", file=sys.stderr)
            raise
        finally:
            progress.close()
        results = results_of(tuning, study.trials())
        write_results(out, results)
    print(results_text(out, results))
    return 0


@contextlib.contextmanager
def _held(path: Path) -> Iterator[None]:
    """Lock a study. Raises :class:`UserError` if another process has locked the folder."""
    with path.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(
                f"{path.parent}: another quad_mpc tune runs in this folder: wait until it ends"
            ) from None
        yield


def _tuning(options: argparse.Namespace) -> Tuning:
    """Return the requested study."""
    from quad_mpc_ros.extras.campaigns.campaign_file import Overrides, located_campaign
    from quad_mpc_ros.extras.campaigns.tuning.tune_file import read_tuning
    from quad_mpc_ros.extras.campaigns.tuning.tune_results import tuning_of

    overrides = Overrides(config=options.config, assignments=options.assignments)
    return new_or_resumed(
        options,
        "study",
        read=lambda: read_tuning(located_campaign(options.file), overrides),
        read_folder=tuning_of,
        overrides=bool(options.config or options.assignments),
    )

"""``quad_mpc tune``: parameters of the controller by campaigns, chosen by an optimiser."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import fcntl
import math
import sys
from collections.abc import Iterator, Sequence
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
    from quad_mpc_ros.extras.campaigns.tuning.study import Observer
    from quad_mpc_ros.extras.campaigns.tuning.trial import Trial
    from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add which study, from where, with which workers, into what."""
    parser.description = (
        "Search the controller parameters with the best campaigns of flights "
        "(docs/howto/tune.md). The first trial is the configuration that the campaigns have. "
        "Writes front.png, trials.csv, front.csv, and parameter files for --config: "
        "front/NUMBER.yaml for each trial that none is better than in every objective, "
        "best.yaml for the one that is chosen. Exit code 0 when all trials were flown. Ctrl-C or "
        "a kill loses only the trial under way. Needs Optuna: pip install "
        "'quad_mpc_ros[campaign]'."
    )
    add_campaign_options(parser, "study")
    parser.add_argument(
        "--trials", type=int, metavar="N", help="number of trials, instead of the file's"
    )
    parser.add_argument(
        "--timeout",
        type=float,
        metavar="S",
        help="no new trial after so many seconds of work, whatever the file says",
    )


def run(options: argparse.Namespace) -> int:
    """Fly what is left to fly, print what was found, and return the exit code."""
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

    _check_limits(options)
    optuna_module()
    tuning = _tuning(options)
    trials = options.trials or tuning.trials
    timeout = tuning.timeout if options.timeout is None else options.timeout
    tuning = dataclasses.replace(tuning, trials=trials, timeout=timeout)
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
        observe = _observer(progress, tuning)
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
    """Keep other processes from the study of a file. Raises :class:`UserError` for one at it."""
    with path.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(
                f"{path.parent}: another quad_mpc tune is running on it: wait for its end"
            ) from None
        yield


def _observer(progress: ProgressLine, tuning: Tuning) -> Observer:
    """Return what shows how far the study is."""
    from quad_mpc_ros.extras.campaigns.tuning.study import time_left
    from quad_mpc_ros.extras.campaigns.tuning.tune_results import results_of

    flights = sum(campaign.flights for campaign in tuning.campaigns.values())

    best: dict[int, Sequence[float]] = {0: ()}  # by the number of trials done

    def observe(done: list[Trial], flown: int) -> None:
        if len(done) not in best:
            best[len(done)] = results_of(tuning, done).best.objectives
        if not progress.due:
            return
        trial = min(len(done) + 1, tuning.trials)
        left = time_left(done, trials=tuning.trials, timeout=tuning.timeout)
        values = " ".join(f"{value:.3g}" for value in best[len(done)])
        progress.show(
            f"trial {trial} of {tuning.trials}, {flown} of {flights} flights"
            + (f"   best {values}" if values else "")
            + (f"   {left:5.0f} s left" if math.isfinite(left) else "")
        )

    return observe


def _tuning(options: argparse.Namespace) -> Tuning:
    """Return the study that is asked for."""
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


def _check_limits(options: argparse.Namespace) -> None:
    if options.trials is not None and options.trials < 1:
        raise UserError(f"--trials: given {options.trials}, expected a number >= 1")
    if options.timeout is not None and not options.timeout >= 0.0:
        raise UserError(f"--timeout: given {options.timeout}, expected a number >= 0")

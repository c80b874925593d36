"""``quad_mpc tune``: parameters of the controller by campaigns, chosen by an optimiser."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import fcntl
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.engines import add_engine_options, engine_of
from quad_mpc_ros.commands.output import default_out, prepared_out, results_in
from quad_mpc_ros.commands.progress import StudyProgress
from quad_mpc_ros.commands.run_options import add_config, add_out, add_set
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.experiments.tuning.study import Observer
    from quad_mpc_ros.experiments.tuning.trial import Trial
    from quad_mpc_ros.experiments.tuning.tune_file import Tuning


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add which study, from where, with which workers, into what."""
    parser.description = (
        "Search parameters of the controller with which campaigns of flights go best "
        "(docs/tuning.md). The first trial is the configuration that the campaigns have. Writes "
        "front.png, trials.csv, front.csv, and parameter files for --config: front/NUMBER.yaml "
        "for each trial that none is better than in every objective, best.yaml for the one that "
        "is chosen. Exit code 0 when all trials were flown, whatever was found. Ctrl-C or a kill "
        "loses the trial under way, no more. Needs Optuna: pip install 'quad_mpc_ros[campaign]'."
    )
    parser.add_argument(
        "file",
        type=Path,
        nargs="?",
        metavar="FILE",
        help="file of the study; may be left out with --resume",
    )
    add_out(parser, "the study; must not hold one", "<name of the file>")
    parser.add_argument(
        "--resume", type=Path, metavar="DIR", help="go on with the study in a folder"
    )
    add_engine_options(parser)
    add_config(parser, "over what the campaigns say: where the study begins")
    add_set(parser, "set one parameter over what the campaigns say")
    parser.add_argument("--trials", type=int, metavar="N", help="so many, whatever the file says")
    parser.add_argument(
        "--timeout",
        type=float,
        metavar="S",
        help="no new trial after so many seconds of work, whatever the file says",
    )


def run(options: argparse.Namespace) -> int:
    """Fly what is left to fly, tell what was found, and return the exit code."""
    from quad_mpc_ros.experiments.tuning.optimiser import optuna_module
    from quad_mpc_ros.experiments.tuning.study import Study
    from quad_mpc_ros.experiments.tuning.tune_results import (
        HOLDS,
        TUNE_NAME,
        begin,
        results_of,
        results_text,
        write_results,
    )

    _check_limits(options)
    optuna_module()
    tuning, out = _resumed(options) if options.resume is not None else _new(options)
    trials = options.trials or tuning.trials
    timeout = tuning.timeout if options.timeout is None else options.timeout
    tuning = dataclasses.replace(tuning, trials=trials, timeout=timeout)
    with engine_of(options) as engine, results_in(out), contextlib.ExitStack() as held:
        if options.resume is None:
            begin(tuning, prepared_out(out, holds=HOLDS))
        held.enter_context(_held(out / TUNE_NAME))
        study = Study(out, tuning)
        print(f"{trials} trials with {engine.workers} workers into {out}", file=sys.stderr)
        progress = StudyProgress()
        observe = _observer(progress, tuning)
        try:
            study.run(engine, observe)
        except KeyboardInterrupt:
            print(f"\nto go on: quad_mpc tune --resume {out}", file=sys.stderr)
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
                f"{path.parent}: another quad_mpc tune is at it: wait for it"
            ) from None
        yield


def _observer(progress: StudyProgress, tuning: Tuning) -> Observer:
    """Return what shows how far the study is."""
    from quad_mpc_ros.experiments.tuning.study import time_left
    from quad_mpc_ros.experiments.tuning.tune_results import results_of

    flights = sum(campaign.flights for campaign in tuning.campaigns.values())

    best: dict[int, Sequence[float]] = {0: ()}  # by the number of trials done

    def observe(done: list[Trial], flown: int) -> None:
        if len(done) not in best:
            best[len(done)] = results_of(tuning, done).best.objectives
        trial = min(len(done) + 1, tuning.trials)
        progress.show(
            f"trial {trial} of {tuning.trials}, {flown} of {flights} flights",
            best=best[len(done)],
            left=time_left(done, trials=tuning.trials, timeout=tuning.timeout),
        )

    return observe


def _new(options: argparse.Namespace) -> tuple[Tuning, Path]:
    """Return the study that is asked for and where it is to go."""
    if options.file is None:
        raise UserError("FILE: expected the file of a study, or --resume DIR")
    tuning = _read(options)
    out = options.out or default_out(options.file.stem)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(
            f"--out: {out} exists and is not overwritten; give a new folder, or go on with "
            f"--resume {out}"
        )
    return tuning, out


def _resumed(options: argparse.Namespace) -> tuple[Tuning, Path]:
    """Return the study of a folder; refuse to go on with another one."""
    from quad_mpc_ros.experiments.tuning.tune_file import identity_text
    from quad_mpc_ros.experiments.tuning.tune_results import tuning_of

    if options.out is not None:
        raise UserError("--out: --resume says where: leave one out")
    tuning = tuning_of(options.resume)
    if options.file is not None:
        if identity_text(_read(options)) != identity_text(tuning):
            raise UserError(
                f"--resume: {options.file} is not, or is no longer, the study of "
                f"{options.resume}: leave the file out, or begin anew with --out"
            )
    elif options.config or options.assignments:
        raise UserError("--resume: a study goes on as it began: leave --config and --set out")
    return tuning, options.resume


def _read(options: argparse.Namespace) -> Tuning:
    from quad_mpc_ros.experiments.campaigns.campaign_file import Overrides
    from quad_mpc_ros.experiments.tuning.tune_file import read_tuning

    overrides = Overrides(config=options.config, assignments=options.assignments)
    return read_tuning(options.file, overrides)


def _check_limits(options: argparse.Namespace) -> None:
    if options.trials is not None and options.trials < 1:
        raise UserError(f"--trials: given {options.trials}, expected a number >= 1")
    if options.timeout is not None and not options.timeout >= 0.0:
        raise UserError(f"--timeout: given {options.timeout}, expected a number >= 0")

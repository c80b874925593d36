# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A study: Optuna proposes trials, campaigns evaluate them, ``study.db`` keeps them.

Trial 0 is the configuration of the campaigns. Each trial is stored as a whole before the next. A
proposal depends on the seed, the number of the trial and the earlier trials, so that a killed
study continues with the same trials.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import math
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros import __version__
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched
from quad_mpc_ros.extras.campaigns.table import NUMBER, Row
from quad_mpc_ros.extras.campaigns.tuning.objectives import (
    FLOWN,
    GIVEN_UP,
    REFUSED,
    Trial,
    check_measured,
    is_lost,
)
from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning
from quad_mpc_ros.extras.campaigns.variation import Choice, Integers, LogUniform, SameAs, Variation

NAME = "study.db"
_OPTUNA_REQUIRED = "quad_mpc tune needs Optuna: pip install 'quad_mpc_ros[campaign]'"
_IDENTITY_KEY, _TRIAL_KEY = "identity", "trial"  # attributes in the file
_CHUNK = 8  # flights between two checks whether a trial is given up

Observer = Callable[[list[Trial], int], None]
"""Called with the finished trials, and the number of finished flights of the next trial."""

FlightObserver = Callable[[int], None]
"""Called after each batch with the number of finished flights of the trial."""


def optuna_module() -> Any:
    """Return Optuna. Raises :class:`UserError` if Optuna is not installed."""
    try:
        optuna = importlib.import_module("optuna")
    except ImportError as error:
        raise UserError(f"{error}. {_OPTUNA_REQUIRED}") from error
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


class Study:
    """The trials in a folder."""

    def __init__(self, folder: Path, tuning: Tuning) -> None:
        """Begin or continue the study in a folder.

        Raises :class:`UserError` if Optuna is not installed, and for the study of other campaigns
        or of another version.
        """
        self._optuna = optuna_module()
        self._tuning = tuning
        self._distributions = {
            name: _distribution(self._optuna.distributions, variation)
            for name, variation in tuning.search.items()
            if not isinstance(variation, SameAs)
        }
        create = functools.partial(
            self._optuna.create_study, directions=["minimize"] * len(tuning.objectives)
        )
        url = f"sqlite:///{(folder / NAME).absolute()}"
        self._file = create(storage=url, study_name="tune", load_if_exists=True)
        identity = {"study": tuning.identity_text(), "version": __version__}
        if self._file.user_attrs.get(_IDENTITY_KEY, identity) != identity:
            raise UserError(
                f"{folder}: started with another version of quad_mpc_ros, or its tune.yaml has "
                "changed, and not only in trials: start again with another --out"
            )
        self._file.set_user_attr(_IDENTITY_KEY, identity)
        self._file.set_metric_names([each.name for each in tuning.objectives])
        # Optuna proposes from memory, so that the file has only complete trials.
        self._memory = create()
        self._memory.add_trials(self._file.trials)

    def trials(self) -> list[Trial]:
        """Return the finished trials, in order."""
        kept = [trial.user_attrs[_TRIAL_KEY] for trial in self._file.trials]
        return [Trial(**{**each, "objectives": tuple(each["objectives"])}) for each in kept]

    def run(self, engine: LocalWorkers, observe: Observer | None = None) -> None:
        """Fly the remaining trials."""
        done = self.trials()
        while len(done) < self._tuning.trials:
            tell = functools.partial(observe, done) if observe is not None else None
            done.append(self._next(engine, len(done), tell))
        if observe is not None:
            observe(done, 0)

    def _next(self, engine: LocalWorkers, number: int, observe: FlightObserver | None) -> Trial:
        """Fly the configuration of the campaigns or a proposal, and store the trial."""
        begun, tuning, reason = time.monotonic(), self._tuning, ""
        point = self._proposed(number) if number else {}
        values = tuning.values_at(point) if number else tuning.base_values()
        rows: dict[str, list[Row]] = {}
        outcome, objectives = REFUSED, list[float]()
        try:
            campaigns = tuning.configured(values) if number else tuning.campaigns
        except (UserError, ValueError) as error:
            reason = str(error)
        else:
            give_up = tuning.give_up if number else 1.0
            rows, given_up = fly_trial(campaigns, engine, give_up=give_up, observe=observe)
            if not number:
                check_measured(tuning.objectives, rows)
            outcome = GIVEN_UP if given_up else FLOWN
            objectives = [each.value(rows.get(each.campaign, [])) for each in tuning.objectives]
        flown = [row for each in rows.values() for row in each]
        trial = Trial(
            number=number,
            values=values,
            outcome=outcome,
            objectives=tuple(objectives),
            reason=reason,
            flights=len(flown),
            lost=sum(map(is_lost, flown)),
            seconds=time.monotonic() - begun,
        )
        self._keep(trial, point)
        return trial

    def _proposed(self, number: int) -> dict[str, Any]:
        """Return the proposed values of the parameters that follow no other."""
        (seed,) = np.random.SeedSequence([self._tuning.seed, number]).generate_state(1)
        sampler = self._optuna.samplers.TPESampler(seed=int(seed), multivariate=True)
        self._memory.sampler = sampler
        asked = self._memory.ask(fixed_distributions=self._distributions)
        self._memory.tell(asked, state=self._optuna.trial.TrialState.FAIL)
        return dict(asked.params)

    def _keep(self, trial: Trial, point: Mapping[str, Any]) -> None:
        """Store a finished trial; it is on disk when this returns.

        Trial 0, which may be outside of the search space, is stored as failed, so that Optuna
        ignores it.
        """
        states = self._optuna.trial.TrialState
        refused = trial.outcome == REFUSED
        state = states.FAIL if not point else states.PRUNED if refused else states.COMPLETE
        kept = self._optuna.trial.create_trial(
            state=state,
            values=list(trial.objectives) if state == states.COMPLETE else None,
            params=dict(point),
            distributions=self._distributions if point else {},
            user_attrs={_TRIAL_KEY: dataclasses.asdict(trial)},
        )
        self._file.add_trial(kept)
        self._memory.add_trial(kept)


def _distribution(kinds: Any, variation: Variation) -> Any:
    """Return Optuna's distribution of a variation."""
    if isinstance(variation, Choice):
        return kinds.CategoricalDistribution(variation.values)
    low, high = variation.extremes()
    if isinstance(variation, Integers):
        return kinds.IntDistribution(low, high)
    return kinds.FloatDistribution(low, high, log=isinstance(variation, LogUniform))


def fly_trial(
    campaigns: Mapping[str, Campaign],
    engine: LocalWorkers,
    *,
    give_up: float,
    observe: FlightObserver | None = None,
) -> tuple[dict[str, list[Row]], bool]:
    """Fly campaigns in order, until more than a share ``give_up`` of a campaign's flights is lost.

    Returns the rows of the flights by campaign, and whether the trial was given up. The share
    refers to all flights of the campaign, so that a trial that would stay below is never given up.
    The share is checked after every eight flights. Later flights do not count, so that the
    result does not depend on the number of workers.
    """
    rows: dict[str, list[Row]] = {}
    for name, campaign in campaigns.items():
        before = sum(map(len, rows.values()))
        flown = rows[name] = []
        while len(flown) < campaign.flights:
            first = len(flown)
            chunks = math.ceil(2 * engine.workers / _CHUNK)
            size = chunks * _CHUNK if give_up < 1.0 else campaign.flights
            numbers = range(first, min(first + size, campaign.flights))
            found: dict[int, Row] = {}
            for batch in engine.fly(campaign, batched(numbers, workers=engine.workers)):
                found |= {int(flight.row[NUMBER]): flight.row for flight in batch}
                if observe is not None:
                    observe(before + first + len(found))
            flown += [found[number] for number in numbers]
            lost = np.cumsum([is_lost(row) for row in flown])
            too_many = np.flatnonzero(lost > give_up * campaign.flights)
            if len(too_many):
                del flown[(1 + too_many[0] // _CHUNK) * _CHUNK :]
                return rows, True
    return rows, False

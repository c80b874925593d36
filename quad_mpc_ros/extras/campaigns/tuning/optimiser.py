# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Proposals of Optuna, and the file of trials.

``study.db`` contains only finished trials, each written as a whole. A proposal depends on the
seed, the number of the trial and the earlier trials, so that a killed study continues with the
same trials.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros import __version__
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.tuning.objectives import REFUSED, Trial
from quad_mpc_ros.extras.campaigns.tuning.search_space import labels
from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning, identity_text
from quad_mpc_ros.extras.campaigns.variation import (
    Choice,
    Integers,
    LogUniform,
    Uniform,
    Variation,
)

NAME = "study.db"

_OPTUNA_REQUIRED = "quad_mpc tune needs Optuna: pip install 'quad_mpc_ros[campaign]'"
_IDENTITY_KEY, _TRIAL_KEY = "identity", "trial"  # attributes in the file


class Optimiser:
    """Proposes points of the search space and stores the trials in a folder."""

    def __init__(self, folder: Path, tuning: Tuning) -> None:
        """Begin or continue the file in a folder.

        Raises :class:`UserError` if Optuna is not installed, and for the file of another study or
        version.
        """
        self._optuna = optuna_module()
        self._optuna.logging.set_verbosity(self._optuna.logging.WARNING)
        self._tuning = tuning
        dimensions = tuning.space().dimensions
        self._distributions = {name: self._distribution(each) for name, each in dimensions.items()}
        directions = ["minimize"] * len(tuning.objectives)
        self._file = self._optuna.create_study(
            storage=f"sqlite:///{(folder / NAME).absolute()}",
            study_name="tune",
            directions=directions,
            load_if_exists=True,
        )
        self._check(folder)
        # Optuna proposes from memory, so that the file has only complete trials.
        self._memory = self._optuna.create_study(directions=directions)
        self._memory.add_trials(self._finished())

    def trials(self) -> list[Trial]:
        """Return the trials in the file, in order."""
        kept = [trial.user_attrs[_TRIAL_KEY] for trial in self._finished()]
        return [Trial(**{**each, "objectives": tuple(each["objectives"])}) for each in kept]

    def proposed(self, number: int) -> dict[str, Any]:
        """Return the proposed point of a trial."""
        (seed,) = np.random.SeedSequence([self._tuning.seed, number]).generate_state(1)
        with _unwarned():
            self._memory.sampler = self._optuna.samplers.TPESampler(
                seed=int(seed), multivariate=True, constant_liar=False
            )
        asked = self._memory.ask(fixed_distributions=self._distributions)
        point = dict(asked.params)
        self._memory.tell(asked, state=self._optuna.trial.TrialState.FAIL)
        return point

    def keep(self, trial: Trial, point: Mapping[str, Any] | None) -> None:
        """Store a finished trial; it is on disk when this returns.

        A trial without a point, outside of the search space, is stored as failed, so that Optuna
        ignores it.
        """
        states = self._optuna.trial.TrialState
        attributes = {_TRIAL_KEY: dataclasses.asdict(trial)}
        if point is None:
            found = self._optuna.trial.create_trial(state=states.FAIL, user_attrs=attributes)
        else:
            refused = trial.outcome == REFUSED
            found = self._optuna.trial.create_trial(
                state=states.PRUNED if refused else states.COMPLETE,
                values=None if refused else list(trial.objectives),
                params=dict(point),
                distributions=self._distributions,
                user_attrs=attributes,
            )
        self._file.add_trial(found)
        self._memory.add_trial(found)

    def _finished(self) -> list[Any]:
        found = self._file.get_trials(deepcopy=False)
        return [trial for trial in found if trial.state.is_finished()]

    def _distribution(self, dimension: Variation) -> Any:
        kinds = self._optuna.distributions
        match dimension:
            case Uniform(low, high):
                is_log = isinstance(dimension, LogUniform)
                return kinds.FloatDistribution(low, high, log=is_log)
            case Integers(low, high):
                return kinds.IntDistribution(low, high)
            case Choice():
                return kinds.CategoricalDistribution(labels(dimension))
        raise AssertionError(dimension)

    def _check(self, folder: Path) -> None:
        """Identify the study in a new file, or reject the file of another study."""
        digest = hashlib.sha256(identity_text(self._tuning).encode()).hexdigest()
        found = self._file.user_attrs.get(_IDENTITY_KEY)
        if found is None:
            with _unwarned():
                self._file.set_metric_names([each.name for each in self._tuning.objectives])
            self._file.set_user_attr(_IDENTITY_KEY, {"tune": digest, "version": __version__})
        elif found["tune"] != digest:
            raise UserError(
                f"{folder}: its tune.yaml has changed since its first trial, and not only in "
                "trials: start again with another --out"
            )
        elif found["version"] != __version__:
            raise UserError(
                f"{folder}: started with quad_mpc_ros {found['version']}, this is "
                f"{__version__}: their flights must not be mixed; start again with another --out"
            )


def optuna_module() -> Any:
    """Return Optuna. Raises :class:`UserError` if Optuna is not installed."""
    try:
        return importlib.import_module("optuna")
    except ImportError as error:
        raise UserError(f"{error}. {_OPTUNA_REQUIRED}") from error


@contextlib.contextmanager
def _unwarned() -> Iterator[None]:
    """Suppress warnings of Optuna about experimental features."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield

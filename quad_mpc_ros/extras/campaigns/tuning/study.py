"""A study: successive trials with parallel flights; each trial is stored before the next.

Trial 0 is the configuration of the campaigns.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers
from quad_mpc_ros.extras.campaigns.tuning.objectives import check_measured
from quad_mpc_ros.extras.campaigns.tuning.optimiser import Optimiser
from quad_mpc_ros.extras.campaigns.tuning.trial import FLOWN, GIVEN_UP, REFUSED, Trial
from quad_mpc_ros.extras.campaigns.tuning.trial_flights import TrialFlights, fly_trial
from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning

Observer = Callable[[list[Trial], int], None]
"""Called with the finished trials, and the number of finished flights of the next trial."""

_FlightObserver = Callable[[int], None]


class Study:
    """The trials in a folder."""

    def __init__(self, folder: Path, tuning: Tuning) -> None:
        """Begin or continue the study in a folder.

        Raises :class:`UserError` if Optuna is not installed, and for the study of other campaigns
        or of another version.
        """
        self._tuning = tuning
        self._space = tuning.space()
        self._optimiser = Optimiser(folder, tuning)

    def trials(self) -> list[Trial]:
        """Return the finished trials, in order."""
        return self._optimiser.trials()

    def run(self, engine: LocalWorkers, observe: Observer | None = None) -> None:
        """Fly the remaining trials."""
        done = self.trials()
        while len(done) < self._tuning.trials:
            tell = functools.partial(observe, done) if observe is not None else None
            done.append(self._next(engine, len(done), tell) if done else self._base(engine, tell))
        if observe is not None:
            observe(done, 0)

    def _base(self, engine: LocalWorkers, observe: _FlightObserver | None) -> Trial:
        """Fly the configuration of the campaigns to the end, and store the trial."""
        begun = time.monotonic()
        flown = fly_trial(self._tuning.campaigns, engine, give_up=None, observe=observe)
        check_measured(self._tuning.objectives, flown.rows)
        trial = self._judged(0, self._space.base_values(), flown, begun)
        try:
            point = self._space.base_point()
        except UserError as error:
            trial = dataclasses.replace(trial, reason=f"not in the search space: {error}")
            self._optimiser.keep(trial, None)
        else:
            self._optimiser.keep(trial, point)
        return trial

    def _next(self, engine: LocalWorkers, number: int, observe: _FlightObserver | None) -> Trial:
        """Fly the proposal of the optimiser, and store the trial."""
        begun = time.monotonic()
        point = self._optimiser.proposed(number)
        values = self._space.values_at(point)
        try:
            campaigns = self._configured(values)
        except (UserError, ValueError) as error:
            trial = Trial(number=number, values=values, outcome=REFUSED, reason=str(error))
        else:
            give_up = self._tuning.give_up
            flown = fly_trial(campaigns, engine, give_up=give_up, observe=observe)
            trial = self._judged(number, values, flown, begun)
        self._optimiser.keep(trial, point)
        return trial

    def _configured(self, values: Mapping[str, Any]) -> dict[str, Campaign]:
        """Return the campaigns with searched values."""
        parameters = self._space.parameters(values)
        changed = {}
        for name, campaign in self._tuning.campaigns.items():
            given = {**campaign.given, "mpc": {**campaign.given["mpc"], **parameters}}
            changed[name] = dataclasses.replace(campaign, given=given)
            changed[name].configured(changed[name].drawn(0))
        return changed

    def _judged(
        self, number: int, values: Mapping[str, Any], flown: TrialFlights, begun: float
    ) -> Trial:
        objectives = self._tuning.objectives
        return Trial(
            number=number,
            values=values,
            outcome=GIVEN_UP if flown.given_up else FLOWN,
            objectives=tuple(each.value(flown.rows.get(each.campaign, [])) for each in objectives),
            flights=flown.flights,
            lost=flown.lost,
            seconds=time.monotonic() - begun,
        )

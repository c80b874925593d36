"""A study: trials one after the other, their flights side by side, each kept before the next one.

Trial 0 is the configuration of the campaigns themselves.
"""

from __future__ import annotations

import dataclasses
import functools
import math
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
"""Called with the trials done, and how many flights of the next one are flown."""

_FlightObserver = Callable[[int], None]


class Study:
    """The trials in a folder."""

    def __init__(self, folder: Path, tuning: Tuning) -> None:
        """Begin the study of a folder, or continue it.

        Raises :class:`UserError` where Optuna is not installed, and for the study of other
        campaigns or of another version.
        """
        self._tuning = tuning
        self._space = tuning.space()
        self._optimiser = Optimiser(folder, tuning)

    def trials(self) -> list[Trial]:
        """Return the trials done, in order."""
        return self._optimiser.trials()

    def run(self, engine: LocalWorkers, observe: Observer | None = None) -> None:
        """Fly trials until there are enough, or have taken long enough."""
        done = self.trials()
        while self._goes_on(done):
            tell = functools.partial(observe, done) if observe is not None else None
            done.append(self._next(engine, len(done), tell) if done else self._base(engine, tell))
        if observe is not None:
            observe(done, 0)

    def _goes_on(self, done: list[Trial]) -> bool:
        in_time = sum(trial.seconds for trial in done) < self._tuning.timeout
        return not done or (in_time and len(done) < self._tuning.trials)

    def _base(self, engine: LocalWorkers, observe: _FlightObserver | None) -> Trial:
        """Fly the campaigns as they are, to the end, and keep that."""
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
        """Fly what the optimiser proposes, and keep that."""
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
        """Return the campaigns with values of what is searched."""
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


def time_left(done: list[Trial], *, trials: int, timeout: float) -> float:
    """Return how long [s] a study is going to take, by the time that its trials took."""
    spent = sum(trial.seconds for trial in done)
    each = spent / len(done) if done else math.nan
    return min(each * (trials - len(done)), max(timeout - spent, 0.0))

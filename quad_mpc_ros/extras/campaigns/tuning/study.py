# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A study: successive trials with parallel flights; each trial is stored before the next.

Trial 0 is the configuration of the campaigns.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.journal import NUMBER, Row
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched
from quad_mpc_ros.extras.campaigns.tuning.objectives import (
    FLOWN,
    GIVEN_UP,
    REFUSED,
    Trial,
    check_measured,
    is_lost,
)
from quad_mpc_ros.extras.campaigns.tuning.optimiser import Optimiser
from quad_mpc_ros.extras.campaigns.tuning.tune_file import Tuning

Observer = Callable[[list[Trial], int], None]
"""Called with the finished trials, and the number of finished flights of the next trial."""

FlightObserver = Callable[[int], None]
"""Called after each batch with the number of finished flights of the trial."""

_FIRST_CHECK = 8


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

    def _base(self, engine: LocalWorkers, observe: FlightObserver | None) -> Trial:
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

    def _next(self, engine: LocalWorkers, number: int, observe: FlightObserver | None) -> Trial:
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


@dataclass(frozen=True, kw_only=True)
class TrialFlights:
    """Rows of the flights by campaign; campaigns not yet started have none."""

    rows: Mapping[str, list[Row]]
    given_up: bool

    @property
    def flights(self) -> int:
        """Number of flights."""
        return sum(map(len, self.rows.values()))

    @property
    def lost(self) -> int:
        """Number of lost flights."""
        return sum(is_lost(row) for rows in self.rows.values() for row in rows)


def fly_trial(
    campaigns: Mapping[str, Campaign],
    engine: LocalWorkers,
    *,
    give_up: float | None,
    observe: FlightObserver | None = None,
) -> TrialFlights:
    """Fly campaigns in order, until more than a share ``give_up`` of a campaign's flights is lost.

    The share is checked after 8, 16, 32 … flights. The share refers to all flights of the
    campaign, so that a trial that would stay below is never given up. Flights beyond the check do
    not count, so that the result does not depend on the number of workers. None never gives up.
    """
    rows: dict[str, list[Row]] = {}
    for name, campaign in campaigns.items():
        before = sum(map(len, rows.values()))
        rows[name] = []
        looks = _looks(campaign.flights) if give_up is not None else [campaign.flights]
        for look in looks:
            if len(rows[name]) < look:
                first = len(rows[name])
                last = min(max(look, first + 2 * engine.workers), campaign.flights)
                numbers = range(first, last)
                rows[name] += _flown(campaign, engine, numbers, before + first, observe)
            counted = rows[name][:look]
            if give_up is not None and sum(map(is_lost, counted)) > give_up * campaign.flights:
                rows[name] = counted
                return TrialFlights(rows=rows, given_up=True)
    return TrialFlights(rows=rows, given_up=False)


def _flown(
    campaign: Campaign,
    engine: LocalWorkers,
    numbers: Sequence[int],
    done: int,
    observe: FlightObserver | None,
) -> list[Row]:
    found: dict[int, Row] = {}
    for flown in engine.fly(campaign, batched(numbers, workers=engine.workers)):
        found |= {int(flight.row[NUMBER]): flight.row for flight in flown}
        if observe is not None:
            observe(done + len(found))
    return [found[number] for number in numbers]


def _looks(flights: int) -> list[int]:
    looks, look = [], _FIRST_CHECK
    while look < flights:
        looks.append(look)
        look *= 2
    return [*looks, flights]

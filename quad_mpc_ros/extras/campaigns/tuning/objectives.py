# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Objectives of a study, Pareto front, and the choice of the best trial.

An objective is a statistic of a figure over the flights of a campaign. A flight is lost if it
crashed or ended with an error. The value of a lost flight is ``lost``, also the maximum for all
other flights, so that a lost flight never improves an objective. A missing figure counts as a lost
flight.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.campaign_file import number
from quad_mpc_ros.extras.campaigns.flight import column_names
from quad_mpc_ros.extras.campaigns.table import VERDICT, Row
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles

CRASHED = "crashed"


def _percentile(values: Sequence[float], percent: int) -> float:
    found = percentiles(values, percent)[f"p{percent}"]
    return math.nan if found is None else found


STATISTICS: Mapping[str, Callable[[Sequence[float]], float]] = {
    "mean": lambda values: float(np.mean(values)),
    **{
        name: functools.partial(_percentile, percent=percent)
        for name, percent in (("median", 50), ("p95", 95), ("p99", 99))
    },
    "max": max,
}

_DEFAULT_TOLERANCE = 0.05
FLOWN, GIVEN_UP, REFUSED = "flown", "given up", "refused"
"""Outcomes of a trial: completed, given up, or an invalid configuration."""


@dataclass(frozen=True, kw_only=True)
class Objective:
    """A number to minimise.

    Attributes:
        campaign: Name of the campaign.
        figure: Column of the table, or ``crashed``: 1 for a lost flight, 0 otherwise.
        of: One of :data:`STATISTICS`, over all flights.
        lost: Value of a lost flight, and maximum for all other flights.
        tolerance: Share above the minimum that counts as equal when the best trial is chosen.
    """

    campaign: str
    figure: str
    of: str
    lost: float
    tolerance: float

    @property
    def name(self) -> str:
        """The name of the column."""
        return f"{self.campaign}.{self.figure}.{self.of}"

    def value(self, rows: Sequence[Row]) -> float:
        """Return the value for some flights; without flights, the value of a lost flight."""
        return STATISTICS[self.of]([self._counted(row) for row in rows] or [self.lost])

    def _counted(self, row: Row) -> float:
        if is_lost(row):
            return self.lost
        if self.figure == CRASHED:
            return 0.0
        value = row.get(self.figure)
        return self.lost if value is None else min(float(value), self.lost)


def is_lost(row: Row) -> bool:
    """Whether a flight crashed or ended with an error."""
    return bool(row[CRASHED]) or bool(row.get("error"))


def check_measured(objectives: Sequence[Objective], rows: Mapping[str, Sequence[Row]]) -> None:
    """Raise :class:`UserError` for a figure that no flight has, except for lost flights."""
    for objective in objectives:
        flown = [row for row in rows.get(objective.campaign, ()) if not is_lost(row)]
        if objective.figure == CRASHED or not flown:
            continue
        if all(row.get(objective.figure) is None for row in flown):
            raise UserError(
                f"objectives: {objective.figure}: no flight of {objective.campaign} has this "
                "figure: choose another"
            )


def read_objectives(given: Any, campaigns: Mapping[str, Campaign]) -> tuple[Objective, ...]:
    """Return the objectives in a file. Raises :class:`UserError`."""
    if not isinstance(given, list) or not given:
        raise ConfigurationError("objectives", given, "a list: - {campaign: …, figure: …, of: …}")
    found = tuple(
        _objective(f"objectives: {place}", each, campaigns)
        for place, each in enumerate(given, start=1)
    )
    names = [objective.name for objective in found]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"objectives: duplicate {name}: remove one of them")
    return found


def _objective(where: str, given: Any, campaigns: Mapping[str, Campaign]) -> Objective:
    keys = {"campaign", "figure", "of", "lost", "tolerance"}
    if not isinstance(given, Mapping) or not {"campaign", "figure"} <= set(given) <= keys:
        expected = "{campaign: NAME, figure: NAME, of: STATISTIC, lost: NUMBER, tolerance: SHARE}"
        raise ConfigurationError(where, given, expected)
    campaign, figure, of = map(str, (given["campaign"], given["figure"], given.get("of", "mean")))
    if campaign not in campaigns:
        raise ConfigurationError(f"{where}: campaign", campaign, f"one of {', '.join(campaigns)}")
    figures = _figures(campaigns[campaign])
    if figure not in figures:
        raise ConfigurationError(f"{where}: figure", figure, f"one of {', '.join(figures)}")
    if of not in STATISTICS:
        raise ConfigurationError(f"{where}: of", of, f"one of {', '.join(STATISTICS)}")
    return Objective(
        campaign=campaign,
        figure=figure,
        of=of,
        lost=_lost(where, figure, given),
        tolerance=number(f"{where}: tolerance", given.get("tolerance", _DEFAULT_TOLERANCE)),
    )


def _lost(where: str, figure: str, given: Mapping[Any, Any]) -> float:
    """Return the value of a lost flight: as given, or the default of the figure's unit."""
    defaults = {CRASHED: 1.0, "_m": 5.0, "_rad": math.pi, "_fraction": 1.0}
    known = (value for unit, value in defaults.items() if figure.endswith(unit))
    return number(f"{where}: lost", given.get("lost", next(known, None)))


def _figures(campaign: Campaign) -> tuple[str, ...]:
    names = column_names(campaign)
    return (CRASHED, *names[names.index(VERDICT[-1]) + 1 :])


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A configuration and its result.

    Attributes:
        number: Number in the study; 0 is the configuration of the campaigns.
        values: Searched values by name.
        outcome: :data:`FLOWN`, :data:`GIVEN_UP` or :data:`REFUSED`.
        objectives: Values of the objectives, of the finished flights if given up; empty if
            rejected.
        reason: Reason for the rejection.
        flights: Number of flights.
        lost: Number of lost flights.
        seconds: Duration [s].
    """

    number: int
    values: Mapping[str, Any]
    outcome: str
    objectives: tuple[float, ...] = ()
    reason: str = ""
    flights: int = 0
    lost: int = 0
    seconds: float = 0.0


def front_of(trials: Sequence[Trial]) -> list[Trial]:
    """Return the front, ordered by the objectives, without duplicates.

    Only completed trials are on the front: the objectives of other trials are estimates.
    """
    flown = [trial for trial in trials if trial.outcome == FLOWN]
    best: dict[tuple[float, ...], Trial] = {}
    for trial in flown:
        gains = [np.subtract(trial.objectives, other.objectives) for other in flown]
        if not any((gain >= 0.0).all() and (gain > 0.0).any() for gain in gains):
            best.setdefault(trial.objectives, trial)
    return [best[objectives] for objectives in sorted(best)]


def chosen(front: Sequence[Trial], objectives: Sequence[Objective]) -> Trial:
    """Return the best trial with the objectives in order of priority.

    For each objective in order, the trials within its tolerance of the minimum remain. The last
    objective decides.
    """
    left = list(front)
    for place, objective in enumerate(objectives):
        last = place == len(objectives) - 1
        least = min(trial.objectives[place] for trial in left)
        most = least + (0.0 if last else objective.tolerance * abs(least))
        left = [trial for trial in left if trial.objectives[place] <= most]
    return left[0]

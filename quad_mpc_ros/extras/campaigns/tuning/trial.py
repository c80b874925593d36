"""Trials of a study, their Pareto front, and the choice of the best trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.extras.campaigns.tuning.objectives import Objective

FLOWN, GIVEN_UP, REFUSED = "flown", "given up", "refused"
"""Outcomes of a trial: completed, given up, or an invalid configuration."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A configuration and its result.

    Attributes:
        number: Number in the study; 0 is the configuration of the campaigns.
        values: Searched values by name.
        outcome: :data:`FLOWN`, :data:`GIVEN_UP` or :data:`REFUSED`.
        objectives: Values of the objectives, of the finished flights if given up; empty if
            rejected.
        reason: Reason for the rejection, or why trial 0 is not in the search space.
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
    best = {
        trial.objectives: trial
        for trial in reversed(flown)
        if not any(_dominates(other.objectives, trial.objectives) for other in flown)
    }
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


def _dominates(one: Sequence[float], other: Sequence[float]) -> bool:
    """Return whether one trial is at least as good in all objectives, and better in one."""
    pairs = list(zip(one, other, strict=True))
    return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)

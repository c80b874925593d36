"""One configuration that was tried, what came of it, and the front of those that are good."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.extras.campaigns.tuning.objectives import Objective

FLOWN, GIVEN_UP, REFUSED = "flown", "given up", "refused"
"""What becomes of a trial: flown to the end, given up on the way, or a configuration that is none.
"""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One configuration and what came of it.

    Attributes:
        number: Its place in the study; 0 is the campaigns' own configuration.
        values: The values of what is searched, by its names.
        outcome: :data:`FLOWN`, :data:`GIVEN_UP` or :data:`REFUSED`.
        objectives: The values of the objectives, of one given up by the flights until then; none
            of one refused.
        reason: Why it was refused, or why trial 0 is not in the search space.
        flights: How many were flown.
        lost: How many of them were lost.
        seconds: How long that took.
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
    """Return the front, in order of the objectives; of trials that are alike the first.

    Only trials flown to the end are on it: what is known of the others is an estimate.
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

    Of the front those stay that are within the tolerance of the least in the first objective, of
    these those within that of the second, and so on; the last one decides.
    """
    left = list(front)
    for place, objective in enumerate(objectives):
        last = place == len(objectives) - 1
        least = min(trial.objectives[place] for trial in left)
        most = least + (0.0 if last else objective.tolerance * abs(least))
        left = [trial for trial in left if trial.objectives[place] <= most]
    return left[0]


def _dominates(one: Sequence[float], other: Sequence[float]) -> bool:
    """Whether one is nowhere worse and somewhere better."""
    pairs = list(zip(one, other, strict=True))
    return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)

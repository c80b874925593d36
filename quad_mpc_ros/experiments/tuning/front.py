"""What remains of a study: the trials that none is better than in every objective."""

from __future__ import annotations

from collections.abc import Sequence

from quad_mpc_ros.experiments.tuning.objectives import Objective
from quad_mpc_ros.experiments.tuning.trial import FLOWN, Trial


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
    """Return the trial that one takes who wants the objectives in their order.

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

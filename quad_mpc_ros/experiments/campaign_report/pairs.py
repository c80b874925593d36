"""The flights that two campaigns have in common: the same vehicle, flown twice."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.experiments.campaign_report.campaign import ReportedCampaign
from quad_mpc_ros.experiments.campaign_report.proportion import Proportion
from quad_mpc_ros.experiments.campaigns.table import NUMBER

BOTH, FIRST, SECOND, NEITHER, ERROR = "both", "first", "second", "neither", "error"
"""In which of the two a vehicle crashed; or an error in one of them."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A figure over the pairs in which neither flight crashed and both have a value.

    ``smaller`` is how often the second campaign has the smaller one, of the pairs that differ.
    """

    name: str
    count: int
    first_median: float
    second_median: float
    median_difference: float
    smaller: Proportion


@dataclass(frozen=True, kw_only=True, eq=False)
class Pairs:
    """Flights of the same number, and equal values of every parameter that both vary.

    Attributes:
        first: A campaign.
        second: Another.
        shared: The parameters that both vary.
        first_rows: The rows of the flights of the first (m,).
        second_rows: Those of the same flights of the second (m,).
    """

    first: ReportedCampaign
    second: ReportedCampaign
    shared: tuple[str, ...]
    first_rows: NDArray[np.int64]
    second_rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.first_rows)

    @cached_property
    def outcomes(self) -> NDArray[np.str_]:
        """What became of each vehicle (m,)."""
        flown = self.first.table.flown[self.first_rows] & self.second.table.flown[self.second_rows]
        first = self.first.crashed[self.first_rows]
        second = self.second.crashed[self.second_rows]
        choices = {
            ERROR: ~flown,
            BOTH: first & second,
            FIRST: first & ~second,
            SECOND: second & ~first,
        }
        return np.select(list(choices.values()), list(choices), default=NEITHER)

    @cached_property
    def counts(self) -> dict[str, int]:
        """How many vehicles had each outcome."""
        return {
            kind: int(np.sum(self.outcomes == kind))
            for kind in (NEITHER, BOTH, FIRST, SECOND, ERROR)
        }

    @cached_property
    def differences(self) -> list[Difference]:
        """Return every figure that both campaigns have, where there is a pair with values."""
        shared = [name for name in self.first.figures if name in self.second.figures]
        return [found for name in shared if (found := self._difference(name)).count]

    def values(self, name: str) -> tuple[Array, Array]:
        """Return a column of the first campaign and of the second (m,), pair by pair."""
        return (
            self.first.numbers(name)[self.first_rows],
            self.second.numbers(name)[self.second_rows],
        )

    def _difference(self, name: str) -> Difference:
        first, second = self.values(name)
        known = (self.outcomes == NEITHER) & np.isfinite(first) & np.isfinite(second)
        change = second[known] - first[known]
        middle = np.median if len(change) else lambda values: np.nan
        return Difference(
            name=name,
            count=len(change),
            first_median=float(middle(first[known])),
            second_median=float(middle(second[known])),
            median_difference=float(middle(change)),
            smaller=Proportion(count=int(np.sum(change < 0)), total=int(np.sum(change != 0))),
        )


def paired(first: ReportedCampaign, second: ReportedCampaign) -> Pairs:
    """Return the flights that two campaigns have in common; none where they share no parameter."""
    shared = tuple(name for name in first.table.varied if name in second.table.varied)
    _, first_rows, second_rows = np.intersect1d(
        first.table.columns[NUMBER], second.table.columns[NUMBER], return_indices=True
    )
    equal = np.full(len(first_rows), bool(shared))
    for name in shared:
        equal &= _equal(
            first.table.columns[name][first_rows], second.table.columns[name][second_rows]
        )
    return Pairs(
        first=first,
        second=second,
        shared=shared,
        first_rows=first_rows[equal],
        second_rows=second_rows[equal],
    )


def _equal(left: NDArray[np.generic], right: NDArray[np.generic]) -> NDArray[np.bool_]:
    if left.dtype.kind != right.dtype.kind:
        return np.zeros(len(left), dtype=np.bool_)
    same = left == right
    if left.dtype.kind == "f":
        same |= np.isnan(left) & np.isnan(right)
    return np.asarray(same)

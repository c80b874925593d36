"""Where campaigns crash: the share of crashed flights over bins of each varied parameter."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.experiments.campaign_report.campaign import ReportedCampaign, all_varied
from quad_mpc_ros.experiments.campaign_report.proportion import Proportion

MOST_BINS = 10  # of numbers
_FEWEST_FLIGHTS = 20  # of a bin on average, or there are fewer bins
_MOST_VALUES = 12  # that get a bin each
_OTHERS = "others"


@dataclass(frozen=True, kw_only=True, eq=False)
class CrashShares:
    """A varied parameter in m bins, and what became of the flights in each.

    Attributes:
        name: The parameter.
        labels: What each bin holds.
        edges: Where the bins of numbers begin and end (m + 1,); none where a value has a bin.
        proportions: The crashed among the flown, for each campaign in each bin.
    """

    name: str
    labels: tuple[str, ...]
    edges: Array
    proportions: tuple[tuple[Proportion, ...], ...]

    @property
    def unevenness(self) -> float:
        """Pearson's chi-square of equal shares by degree of freedom; near 1 for pure chance."""
        statistic, freedom = 0.0, 0
        for bins in self.proportions:
            known = [each for each in bins if each.total]
            whole = Proportion(
                count=sum(each.count for each in known), total=sum(each.total for each in known)
            )
            if not 0 < whole.count < whole.total:
                continue
            statistic += sum(
                (each.count - each.total * whole.share) ** 2
                / (each.total * whole.share * (1 - whole.share))
                for each in known
            )
            freedom += len(known) - 1
        return statistic / freedom if freedom else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Bins:
    """Bins, and the bin of each flight of each campaign: -1 for none."""

    labels: tuple[str, ...]
    edges: Array
    numbers: list[NDArray[np.int64]]


def crash_shares(campaigns: Sequence[ReportedCampaign]) -> list[CrashShares]:
    """Return the shares over every varied parameter, the most uneven first.

    Numbers get bins of equally many flights, of all campaigns together; texts, and numbers of few
    values, a bin a value. Flights that raised an error are left out.
    """
    every = [_shares(name, campaigns) for name in all_varied(campaigns)]
    return sorted(every, key=lambda shares: -shares.unevenness)


def _shares(name: str, campaigns: Sequence[ReportedCampaign]) -> CrashShares:
    bins = _binned([_column(each, name) for each in campaigns])
    proportions = tuple(
        tuple(
            Proportion(
                count=int(np.sum(each.crashed & (numbers == number))),
                total=int(np.sum(each.table.flown & (numbers == number))),
            )
            for number in range(len(bins.labels))
        )
        for each, numbers in zip(campaigns, bins.numbers, strict=True)
    )
    return CrashShares(name=name, labels=bins.labels, edges=bins.edges, proportions=proportions)


def _column(campaign: ReportedCampaign, name: str) -> NDArray[np.object_]:
    """Return the values of the flown flights (n,), None for no value."""
    column = campaign.table.columns.get(name)
    if column is None:
        return np.full(len(campaign.table), None, dtype=np.object_)
    values = column.astype(np.object_)
    missing = column == "" if column.dtype.kind == "U" else np.isnan(column)
    values[missing | ~campaign.table.flown] = None
    return np.asarray(values)


def _binned(columns: Sequence[NDArray[np.object_]]) -> _Bins:
    values = [value for column in columns for value in column.tolist() if value is not None]
    distinct = set(values)
    if len(distinct) <= _MOST_VALUES or any(isinstance(value, str) for value in distinct):
        return _binned_by_value(columns, values)
    count = int(np.clip(len(values) // _FEWEST_FLIGHTS, 2, MOST_BINS))
    edges = np.unique(np.quantile(np.array(values), np.linspace(0.0, 1.0, count + 1)))
    return _Bins(
        labels=tuple(f"{low:.4g} to {high:.4g}" for low, high in pairwise(edges.tolist())),
        edges=edges,
        numbers=[_between(column, edges) for column in columns],
    )


def _between(column: NDArray[np.object_], edges: Array) -> NDArray[np.int64]:
    values = np.array([np.nan if value is None else value for value in column], dtype=np.float64)
    numbers = np.searchsorted(edges[1:-1], values, side="right")
    return np.where(np.isnan(values), -1, numbers)


def _binned_by_value(columns: Sequence[NDArray[np.object_]], values: Sequence[object]) -> _Bins:
    ordered = sorted(set(values), key=lambda value: (isinstance(value, str), value))
    labels = [_label(value) for value in ordered]
    if len(labels) > _MOST_VALUES:
        common = {_label(value) for value, _ in Counter(values).most_common(_MOST_VALUES - 1)}
        labels = [*(label for label in labels if label in common), _OTHERS]
    place = {label: number for number, label in enumerate(labels)}
    return _Bins(
        labels=tuple(labels),
        edges=np.zeros(0),
        numbers=[
            np.array(
                [
                    -1 if value is None else place.get(_label(value), len(labels) - 1)
                    for value in column
                ],
                dtype=np.int64,
            )
            for column in columns
        ],
    )


def _label(value: object) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"

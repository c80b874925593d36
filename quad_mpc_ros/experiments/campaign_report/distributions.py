"""How the figures of campaigns are distributed: counts over bins, and cumulative shares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.experiments.campaign_report.campaign import ReportedCampaign, all_figures

BINS = 40
MOST_STEPS = 300  # of a cumulative curve

POPULATIONS: dict[str, Callable[[ReportedCampaign], NDArray[np.bool_]]] = {
    "did not crash": lambda campaign: campaign.unharmed,
    "all flown": lambda campaign: campaign.table.flown,
}
"""Which flights figures are of; a flight that raised an error was not flown."""


def distributions(campaigns: Sequence[ReportedCampaign]) -> dict[str, dict[str, Any]]:
    """Return the distributions by figure and population, as JSON holds them.

    Each has ``linear`` and ``log``: ``edges`` (m + 1,), and ``counts`` (campaigns, m) of all
    flights that have a value (``log``: a value above 0, None where no flight has one); and
    ``cumulative``: for each campaign ``x`` and the share ``y`` of flights that have at most x.
    """
    return {
        name: {
            population: _distribution(
                [_known(each.numbers(name)[chosen(each)]) for each in campaigns]
            )
            for population, chosen in POPULATIONS.items()
        }
        for name in all_figures(campaigns)
    }


def _distribution(values: Sequence[Array]) -> dict[str, Any]:
    return {
        "linear": _histogram(values, logarithmic=False),
        "log": _histogram([each[each > 0.0] for each in values], logarithmic=True),
        "cumulative": [_cumulative(each) for each in values],
    }


def _histogram(values: Sequence[Array], *, logarithmic: bool) -> dict[str, Any] | None:
    together = np.concatenate(values)
    if not len(together):
        return None
    if logarithmic:
        edges = 10.0 ** np.histogram_bin_edges(np.log10(together), BINS)
        # Rounding must not put the least and the greatest outside.
        edges[0], edges[-1] = min(edges[0], together.min()), max(edges[-1], together.max())
    else:
        edges = np.histogram_bin_edges(together, BINS)
    counts = [np.histogram(each, edges)[0].tolist() for each in values]
    return {"edges": edges.tolist(), "counts": counts}


def _cumulative(values: Array) -> dict[str, list[float]]:
    count = len(values)
    if count <= MOST_STEPS:
        shares = np.arange(1, count + 1) / count if count else np.zeros(0)
        return {"x": np.sort(values).tolist(), "y": shares.tolist()}
    shares = np.linspace(1.0 / count, 1.0, MOST_STEPS)
    return {
        "x": np.quantile(values, shares, method="inverted_cdf").tolist(),
        "y": shares.tolist(),
    }


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]

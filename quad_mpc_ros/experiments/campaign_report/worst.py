"""The worst flights of a campaign by a figure."""

from __future__ import annotations

from typing import Any

import numpy as np

from quad_mpc_ros.experiments.campaign_report.campaign import ReportedCampaign
from quad_mpc_ros.experiments.campaigns.table import NUMBER

MOST = 10  # of those that crashed, and of those that did not

_WORST_IS_LEAST = ("altitude_min_m",)


def worst_flights(campaign: ReportedCampaign, figure: str) -> list[list[Any]]:
    """Return flights, worst first: crashed ones, then others that have a value.

    Each is its number, the kind of its crash, the time of that [s] and the figure; None for no
    value. Worst is the greatest, of the least altitude the least.
    """
    values = campaign.numbers(figure)
    badness = -values if figure in _WORST_IS_LEAST else values
    order = np.argsort(-badness, kind="stable")  # NaN comes last
    unharmed = campaign.unharmed & np.isfinite(values)
    rows = [
        row
        for among in (campaign.crashed, unharmed)
        for row in order[among[order]][:MOST].tolist()
    ]
    columns = campaign.table.columns
    times = campaign.numbers("crash_time_s")
    return [
        [
            int(columns[NUMBER][row]),
            str(columns["crash"][row]),
            _number(times[row]),
            _number(values[row]),
        ]
        for row in rows
    ]


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None

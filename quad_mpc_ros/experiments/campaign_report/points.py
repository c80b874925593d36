"""What the browser shows of flights: points, few enough of a large campaign, and the worst."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.experiments.campaign_report.campaign import CRASHES, ReportedCampaign
from quad_mpc_ros.experiments.campaign_report.pairs import (
    BOTH,
    ERROR,
    FIRST,
    NEITHER,
    SECOND,
    Difference,
    Pairs,
)
from quad_mpc_ros.experiments.campaigns.table import NUMBER

MOST_POINTS = 5000  # of all campaigns of a page
MOST_WORST = 10  # of those that crashed, and of those that did not

_WORST_IS_LEAST = ("altitude_min_m",)

_UNHARMED, _CRASHED = "unharmed", "crashed"
_FINE = {"symbol": "circle", "size": 5, "opacity": 0.5}
_FAILED = {"symbol": "x", "size": 7, "opacity": 0.9}
_COLOURS = {
    _UNHARMED: style.FLOWN,
    "ground": "#D55E00",
    "upside_down": "#CC79A7",
    "away": "#E69F00",
    ERROR: style.FAINT,
}
_OTHER = "#000000"


def evenly_chosen(first: NDArray[np.bool_], most: int) -> NDArray[np.int64]:
    """Return at most so many rows in order: those of ``first`` (n,) before the rest.

    What there is no room for all of is chosen evenly.
    """
    wanted, rest = np.flatnonzero(first), np.flatnonzero(~first)
    kept = _evenly(wanted, most)
    return np.sort(np.concatenate([kept, _evenly(rest, most - len(kept))]))


def flight_points(
    campaign: ReportedCampaign, *, most: int, colour: str | None = None
) -> dict[str, Any]:
    """Return at most so many flights of a campaign, crashed ones before others, as JSON has them.

    ``groups`` says how to draw them, ``group`` (n,) which of them each flight is in, ``columns``
    what may be drawn; ``commands`` what makes flights again, before and after their number. With
    a colour, of several campaigns, the kinds of crashes are one.
    """
    kinds = np.where(campaign.table.flown, campaign.table.columns["crash"], ERROR)
    kinds = np.where(campaign.crashed | ~campaign.table.flown, kinds, _UNHARMED)
    crashes = list(campaign.crash_kinds())
    if colour is not None:
        crashes, kinds = [_CRASHED], np.where(campaign.crashed, _CRASHED, kinds)
    known = [_UNHARMED, *crashes, ERROR]
    rows = evenly_chosen(campaign.crashed, most)
    names = [*campaign.table.varied, *campaign.figures, "crash_time_s"]
    return {
        **_drawn({kind: _group(kind, campaign.name, colour) for kind in known}, kinds[rows]),
        "total": len(campaign.table),
        "flight": campaign.table.columns[NUMBER][rows].tolist(),
        "columns": {name: _plain(campaign.table.columns[name][rows]) for name in names},
        "commands": [_command(campaign)],
    }


def pair_points(pairs: Pairs, *, most: int) -> dict[str, Any]:
    """Return at most so many pairs, those that crashed in one or both before others.

    As :func:`flight_points`; ``figures`` has, by name, those of the ``first`` and the ``second``
    campaign and how they differ in a sentence (``summary``).
    """
    first, second = pairs.first, pairs.second
    groups = {
        NEITHER: {"name": "crashed in neither", "colour": style.FLOWN, **_FINE},
        BOTH: {"name": "in both", "colour": style.INK, **_FAILED},
        FIRST: {"name": f"only in {first.name}", "colour": "#D55E00", **_FAILED},
        SECOND: {"name": f"only in {second.name}", "colour": "#009E73", **_FAILED},
        ERROR: {"name": "error", "colour": style.FAINT, **_FAILED},
    }
    rows = evenly_chosen(np.isin(pairs.outcomes, (BOTH, FIRST, SECOND)), most)
    columns = first.table.columns
    return {
        **_drawn(groups, pairs.outcomes[rows]),
        "total": len(pairs),
        "flight": columns[NUMBER][pairs.first_rows[rows]].tolist(),
        "columns": {name: _plain(columns[name][pairs.first_rows[rows]]) for name in pairs.shared},
        "figures": {
            each.name: {
                "first": _plain(pairs.values(each.name)[0][rows]),
                "second": _plain(pairs.values(each.name)[1][rows]),
                "summary": _summary(each, pairs),
            }
            for each in pairs.differences
        },
        "commands": [_command(each) for each in (first, second)],
    }


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
        for row in order[among[order]][:MOST_WORST].tolist()
    ]
    columns = campaign.table.columns
    times = campaign.numbers("crash_time_s")
    return [
        [
            int(columns[NUMBER][row]),
            str(columns["crash"][row]),
            *_plain(np.array([times[row], values[row]])),
        ]
        for row in rows
    ]


def _evenly(rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    count = min(len(rows), most)
    return rows[np.arange(count) * len(rows) // max(count, 1)]


def _group(kind: str, campaign: str, colour: str | None) -> dict[str, Any]:
    shape = _FINE if kind == _UNHARMED else _FAILED
    own = _COLOURS.get(kind, _OTHER)
    look = {"colour": own if kind == ERROR else colour or own, **shape}
    names = {_UNHARMED: "did not crash", ERROR: "error", **CRASHES}
    name = names.get(kind, kind or "not said how")
    return {"name": name if colour is None else f"{campaign}: {name}", **look}


def _summary(figure: Difference, pairs: Pairs) -> str:
    if not figure.smaller.total:
        return f"Equal in all of {figure.count} pairs."
    return (
        f"Over {figure.count} vehicles that crashed in neither: smaller in {pairs.second.name} in "
        f"{figure.smaller} that differ; median difference {figure.median_difference:.4g}."
    )


def _command(campaign: ReportedCampaign) -> dict[str, Any]:
    before, after = campaign.command_parts
    return {"before": before, "after": after, "digits": campaign.digits}


def _drawn(groups: Mapping[str, Mapping[str, Any]], kinds: NDArray[np.str_]) -> dict[str, Any]:
    place = {kind: number for number, kind in enumerate(groups)}
    return {"groups": list(groups.values()), "group": [place[kind] for kind in kinds.tolist()]}


def _plain(values: NDArray[Any]) -> list[float | str | None]:
    """Return values as JSON has them: six digits are more than a screen shows."""
    return [
        value
        if isinstance(value, str)
        else float(f"{value:.6g}")
        if math.isfinite(value)
        else None
        for value in values.tolist()
    ]

"""The share of crashed flights over every varied parameter as a Plotly figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.report.plotting import CAMPAIGN_COLOURS, lay_out, plotly
from quad_mpc_ros.experiments.campaign_report.crash_shares import CrashShares

_COLUMNS = 3
_ROW_HEIGHT, _MARGINS = 230, 90  # pixels
_NARROW = 0.8  # of its place is the bar of a value
_MOST_TICKS = 6
_WIDEST_LABEL = 14  # characters on an axis
_LOWEST_TOP, _HIGHEST_TOP = 0.05, 1.05  # of the axis of shares
_HOVER = "%{customdata}<extra></extra>"


def shares_figure(shares: Sequence[CrashShares], names: Sequence[str]) -> Any:
    """Return a panel for each parameter: a bar a bin and campaign, with its 95 % interval.

    Args:
        shares: At least one parameter, with at least one bin each.
        names: The campaigns, in the order of their proportions.
    """
    columns = min(_COLUMNS, len(shares))
    rows = -(-len(shares) // columns)
    figure = plotly("subplots").make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=[escape(each.name) for each in shares],
        shared_yaxes="all",
        horizontal_spacing=0.05,
        vertical_spacing=0.3 / rows,
    )
    for number, each in enumerate(shares):
        place = {"row": number // columns + 1, "col": number % columns + 1}
        for campaign, name in enumerate(names):
            bars = _bars(each, campaign, name, of=len(names))
            bars.showlegend = number == 0 and len(names) > 1
            figure.add_trace(bars, **place)
        figure.update_xaxes(range=[-0.55, len(each.labels) - 0.45], **_ticks(each), **place)
    figure.update_xaxes(showgrid=False, zeroline=False)
    figure.update_yaxes(tickformat=".0%", range=[0.0, _top(shares)])
    height = _MARGINS + _ROW_HEIGHT * rows
    lay_out(figure, height=height, margin={"l": 60, "r": 20, "b": 40}, bargap=0.0)
    return figure


def _bars(shares: CrashShares, campaign: int, name: str, *, of: int) -> Any:
    bins = shares.proportions[campaign]
    # The bins stand at 0, 1, …: those of numbers hold equally many flights and are equally wide.
    width = (1.0 if len(shares.edges) else _NARROW) / of
    heights = np.array([each.share for each in bins])
    low, high = np.array([each.interval for each in bins]).T
    return plotly("graph_objects").Bar(
        x=np.arange(len(bins)) + (campaign - 0.5 * (of - 1)) * width,
        y=heights,
        width=width,
        name=name,
        legendgroup=name,
        marker={
            "color": CAMPAIGN_COLOURS[campaign % len(CAMPAIGN_COLOURS)] if of > 1 else style.BOUND,
            "opacity": 0.75,
            "line": {"color": "white", "width": 1},
        },
        error_y={
            "array": high - heights,
            "arrayminus": heights - low,
            "color": style.INK,
            "thickness": 1,
            "width": 2,
        },
        customdata=[
            f"{escape(f'{name}: {shares.name} {label}')}<br>{each} crashed"
            for label, each in zip(shares.labels, bins, strict=True)
        ],
        hovertemplate=_HOVER,
    )


def _ticks(shares: CrashShares) -> dict[str, Any]:
    """Return what stands on the axis: values below their bin, numbers where bins meet."""
    if not len(shares.edges):
        texts = [
            label if len(label) <= _WIDEST_LABEL else f"{label[: _WIDEST_LABEL - 1]}…"
            for label in shares.labels
        ]
        return {"tickvals": list(range(len(texts))), "ticktext": list(map(escape, texts))}
    places = range(0, len(shares.edges), -(-len(shares.edges) // _MOST_TICKS))
    return {
        "tickvals": [place - 0.5 for place in places],
        "ticktext": [f"{shares.edges[place]:.3g}" for place in places],
        "ticks": "outside",
    }


def _top(shares: Sequence[CrashShares]) -> float:
    """Return where the axis ends: above every bar, and every interval that is not very wide."""
    bars = [
        min(max(1.15 * each.share, each.interval[1]), 2.0 * each.share + 0.1)
        for of in shares
        for bins in of.proportions
        for each in bins
        if each.total
    ]
    top = max([value for value in bars if math.isfinite(value)], default=0.0)
    return min(max(top, _LOWEST_TOP), _HIGHEST_TOP)

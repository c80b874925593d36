# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The picture of a campaign: distribution of the error, and error over each varied parameter.

The axes at the top show the cumulative distribution of the settled errors of completed flights.
Below, each varied parameter has axes with the mean settled error of each flight, medians of ten
bins, and a cross at the top edge for each crash.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.configuration.atomic_file import placed
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.flying import FIGURE_NAME, counts_text
from quad_mpc_ros.extras.campaigns.table import Row
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MEAN, _MAXIMUM = "settled_error_mean_m", "settled_error_max_m"
_COLUMNS, _TOP_LINES = 3, 2
_WIDTH, _LINE_HEIGHT, _DPI = 8.4, 1.8, 110  # inch, 1/inch; readable at the width of a page
_BINS, _MIN_IN_BIN = 10, 5
_MAX_TICK_CHARACTERS = 30  # of all names below one axis


def write_figure(folder: Path, campaign: Campaign, rows: Sequence[Row]) -> None:
    """Draw the flights of a campaign as PNG into its folder. Raises ``OSError``."""
    with placed(folder / FIGURE_NAME) as draft:
        style.save(campaign_figure(campaign, rows), draft)


def campaign_figure(campaign: Campaign, rows: Sequence[Row]) -> Figure:
    """Return the figure of the flights of a campaign."""
    flown = [row for row in rows if not row.get("error")]
    units = {column: _unit(campaign, column) for column in campaign.columns}
    shown = [column for column in units if not column.endswith(".seed")]
    lines = -(-len(shown) // _COLUMNS)
    figure = style.new_figure(_WIDTH, _LINE_HEIGHT * (_TOP_LINES + lines), dpi=_DPI)
    figure.suptitle(counts_text(rows), x=0.01, ha="left", fontsize=12, color=style.INK)
    grid = figure.add_gridspec(_TOP_LINES + lines, _COLUMNS)
    top = figure.add_subplot(grid[:_TOP_LINES, :])
    _draw_distribution(top, [row for row in flown if not row["crashed"]])
    first: Axes | None = None
    for place, column in enumerate(shown):
        axes = figure.add_subplot(
            grid[_TOP_LINES + place // _COLUMNS, place % _COLUMNS], sharey=first
        )
        first = first or axes
        _draw_parameter(axes, column, flown)
        axes.set_xlabel(f"{column} {units[column]}", fontsize=8, color=style.INK)
        if place % _COLUMNS == 0:
            axes.set_ylabel("mean error [m]", fontsize=8, color=style.INK)
    return figure


def _draw_distribution(axes: Axes, completed: Sequence[Row]) -> None:
    """Draw the cumulative distributions of mean and maximum, with percentiles in the legend."""
    style.tidy(axes)
    positive = False
    for name, label, colour in (
        (_MEAN, "mean", style.FLOWN),
        (_MAXIMUM, "maximum", style.REFERENCE),
    ):
        errors = _numbers(completed, name)
        errors = np.sort(errors[np.isfinite(errors)])
        positive |= bool((errors > 0.0).any())
        shares = np.arange(1, len(errors) + 1) / len(errors)
        known = percentiles(errors, 50, 95).items()
        texts = [f"{key} {value:.3g} m" for key, value in known if value is not None]
        label = ", ".join([label, *texts])
        axes.step(errors, shares, where="post", color=colour, linewidth=1.8, label=label)
    if positive:
        style.use_log_scale(axes, "x")
    axes.set_yticks([0.0, 0.5, 0.95], ["0", "p50", "p95"])
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("error of a flight after the settle time [m]", fontsize=8, color=style.INK)
    axes.set_ylabel("share of completed flights", fontsize=8, color=style.INK)
    style.legend(axes)


def _draw_parameter(axes: Axes, column: str, flown: Sequence[Row]) -> None:
    """Draw the mean errors over a varied parameter, their medians, and the crashes."""
    style.tidy(axes)
    axes.margins(x=0.05, y=0.15)
    # A vector has fewer elements in some flights than in others.
    rows = [row for row in flown if row.get(column) is not None]
    values: NDArray[Any] = np.array([row[column] for row in rows])
    if values.dtype.kind in "Ub":  # names
        names, bins = np.unique(values, return_inverse=True)
        length = max(_MAX_TICK_CHARACTERS // len(names), 1)
        axes.set_xticks(range(len(names)), [str(name)[:length] for name in names])
        values = bins
    else:
        bins = _bins(values)
        axes.locator_params(axis="x", nbins=4)
    crashed = np.array([bool(row["crashed"]) for row in rows], dtype=np.bool_)
    errors = _numbers(rows, _MEAN)
    known = ~crashed & np.isfinite(errors)
    axes.plot(values[known], errors[known], ".", color=style.FLOWN, markersize=3, alpha=0.5)
    groups = [known & (bins == each) for each in np.unique(bins[known])]
    medians = [(np.median(values[group]), np.median(errors[group])) for group in groups]
    axes.plot(*np.reshape(medians, (-1, 2)).T, "o-", color=style.INK, markersize=3, linewidth=1.0)
    style.use_log_scale(axes, "y")
    edge = np.full(np.count_nonzero(crashed), 0.96)
    across = axes.get_xaxis_transform()
    axes.plot(values[crashed], edge, "x", transform=across, color=style.BOUND, markersize=5)


def _bins(values: NDArray[Any]) -> NDArray[np.int64]:
    """Return the bin of each value (n,): bins of about equal size, equal values in one bin."""
    count = min(_BINS, max(len(values) // _MIN_IN_BIN, 1))
    smaller = np.searchsorted(np.sort(values), values)
    return np.asarray(count * smaller // max(len(values), 1), dtype=np.int64)


def _unit(campaign: Campaign, column: str) -> str:
    """Return the unit of a column in brackets; columns of a vector end with the element."""
    name = column if column in campaign.targets else column.rpartition(".")[0]
    unit = campaign.targets[name].spec.unit
    return f"[{unit}]" if unit else ""


def _numbers(rows: Sequence[Row], name: str) -> Array:
    """Return the values of a column (n,), NaN for none."""
    values = [row.get(name) for row in rows]
    return np.array([np.nan if value is None else float(value) for value in values])

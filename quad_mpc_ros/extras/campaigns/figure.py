"""The first picture of a campaign: the settled error, its distribution and its causes.

The upper axes show the cumulative distribution of the settled error over the flights that did not
crash. Each axes below shows the mean settled error over one varied parameter, with the crashed
flights marked on its upper edge. The parameters with the strongest effect come first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.configuration.atomic_file import placed
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.campaigns.campaign import Campaign, Target
from quad_mpc_ros.extras.campaigns.flying import FIGURE_NAME
from quad_mpc_ros.extras.campaigns.table import Row
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

ERROR = "settled_error_mean_m"
_MAX_ERROR = "settled_error_max_m"

_MAX_AXES = 9
_COLUMNS = 3
_BINS, _MIN_IN_BIN = 10, 5  # bins of equally many flights
_MAX_VALUES = 12  # of a number, up to which each value is a bin
_MAX_TICK_CHARACTERS = 40  # characters of all labels of an axis
_DPI = 130


def write_figure(folder: Path, campaign: Campaign, rows: Sequence[Row]) -> Path:
    """Draw a campaign into its folder and return the path of the PNG. Raises ``OSError``."""
    with placed(folder / FIGURE_NAME, overwrite=True) as draft:
        style.save(campaign_figure(campaign, rows), draft)
    return folder / FIGURE_NAME


def campaign_figure(campaign: Campaign, rows: Sequence[Row]) -> Figure:
    """Return the figure of a campaign's flights."""
    flown = [row for row in rows if not row.get("error")]
    crashed = np.array([bool(row["crashed"]) for row in flown], dtype=np.bool_)
    error = _numbers(flown, ERROR)
    columns = {
        name: np.array([row[name] for row in flown])
        for name in campaign.columns
        if _target(campaign, name).parameter != "seed"
    }
    shown = strongest(columns, np.where(crashed, np.inf, error))[:_MAX_AXES]
    lines = max(-(-len(shown) // _COLUMNS), 1)
    figure = style.new_figure(10.0, 3.6 + 2.3 * lines, dpi=_DPI)
    grid = figure.add_gridspec(2, 1, height_ratios=[3.6, 2.3 * lines])
    upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    _title(upper, _counts(rows, flown), size=12)
    _draw_distribution(upper.add_subplot(), flown, crashed)
    of = f"{len(shown)} of {len(columns)} varied parameters"
    _title(lower, f"{of}, strongest effect first: flights, medians, and × where a flight crashed")
    first: Axes | None = None
    for number, name in enumerate(shown):
        axes = lower.add_subplot(lines, _COLUMNS, number + 1, sharey=first)
        first = first or axes
        _draw_effect(axes, columns[name], error, crashed)
        unit = _target(campaign, name).spec.unit
        axes.set_xlabel(f"{name} [{unit}]" if unit else name, fontsize=8, color=style.INK)
        if number % _COLUMNS == 0:
            axes.set_ylabel("mean settled error [m]", fontsize=8, color=style.INK)
        else:
            axes.tick_params(labelleft=False)
    if first is not None:
        _set_error_axis(first, "y", error[~crashed])
    return figure


def strongest(columns: dict[str, NDArray[Any]], error: Array) -> list[str]:
    """Return the names of the columns that vary, those with the strongest effect first.

    The effect is the Kruskal-Wallis statistic of the errors (n,) in bins of the column, divided by
    its degrees of freedom: about 1 for a column without effect. Crashed flights have an infinite
    error, flights without a value NaN.
    """
    known = ~np.isnan(error)
    ordered = np.sort(error[known])
    first, after = (np.searchsorted(ordered, error[known], side) for side in ("left", "right"))
    ranks = np.asarray(0.5 * (first + after), dtype=np.float64)  # of equal errors the mean
    effects = {name: _effect(values[known], ranks) for name, values in columns.items()}
    varied = [name for name, values in columns.items() if len(np.unique(values)) > 1]
    return sorted(varied, key=lambda name: -effects[name])


def _effect(values: NDArray[Any], ranks: Array) -> float:
    bins = _bins(values)
    groups = [ranks[bins == each] for each in np.unique(bins)]
    variance = float(np.var(ranks, ddof=1)) if len(ranks) > 1 else 0.0
    if len(groups) < 2 or variance == 0.0:
        return 0.0
    between = sum(len(each) * float(np.mean(each) - np.mean(ranks)) ** 2 for each in groups)
    return between / variance / (len(groups) - 1)


def _bins(values: NDArray[Any]) -> NDArray[np.int64]:
    """Return the bin of each value (n,): few values have a bin each, many share ten."""
    if _is_listed(values):
        return np.unique(values, return_inverse=True)[1].astype(np.int64)
    count = min(_BINS, len(values) // _MIN_IN_BIN)
    edges = np.quantile(values, np.arange(1, count) / count) if count > 1 else np.zeros(0)
    return np.searchsorted(edges, values, side="right").astype(np.int64)


def _is_listed(values: NDArray[Any]) -> bool:
    """Whether values are names, or few numbers that recur: each has its own place on the axis."""
    most = min(_MAX_VALUES, len(values) // 2)
    return values.dtype.kind not in "fi" or len(np.unique(values)) <= most


def _draw_distribution(axes: Axes, flown: Sequence[Row], crashed: NDArray[np.bool_]) -> None:
    """Draw the cumulative distribution of mean and maximum, with p50 and p95."""
    for name, label, colour in (
        (ERROR, "mean of a flight", style.FLOWN),
        (_MAX_ERROR, "maximum of a flight", style.REFERENCE),
    ):
        values = np.sort(_numbers(flown, name)[~crashed])
        values = values[np.isfinite(values)]
        if not len(values):
            continue
        shares = np.arange(1, len(values) + 1) / len(values)
        axes.step(values, shares, where="post", color=colour, linewidth=1.8, label=label)
        for key, value in percentiles(values, 50, 95).items():
            if value is None or key == "max":
                continue
            share = int(key[1:]) / 100
            axes.plot(value, share, "o", color=colour, markersize=5)
            text = f"{key} {value:.3g} m"
            axes.annotate(
                text,
                (value, share),
                xytext=(7, -4),
                textcoords="offset points",
                va="top",
                fontsize=8,
                color=style.INK,
            )
    axes.set_ylim(0.0, 1.02)
    style.tidy(axes)
    shown = np.concatenate([_numbers(flown, name)[~crashed] for name in (ERROR, _MAX_ERROR)])
    _set_error_axis(axes, "x", shown)
    axes.set_xlabel("distance to the reference after the settle time [m]", fontsize=8)
    axes.set_ylabel("share of the flights that did not crash", fontsize=8)
    style.legend(axes)


def _draw_effect(
    axes: Axes, values: NDArray[Any], error: Array, crashed: NDArray[np.bool_]
) -> None:
    """Draw errors (n,) over a varied parameter (n,), their medians, and the crashed flights."""
    style.tidy(axes)
    bins = _bins(values)
    if _is_listed(values):
        names = np.unique(values)
        texts = [f"{name:g}" if values.dtype.kind in "fi" else str(name) for name in names]
        width = _MAX_TICK_CHARACTERS // len(names)
        ticks = [text[:width] for text in texts] if width > 2 else []
        axes.set_xticks(range(len(ticks)), ticks)
        # Flights of one value stand side by side.
        x = bins + 0.6 * ((np.arange(len(bins)) * 0.6180339887) % 1.0) - 0.3
    else:
        axes.locator_params(axis="x", nbins=5)
        x = values.astype(np.float64)
    good = ~crashed & np.isfinite(error)
    axes.plot(x[good], error[good], ".", color=style.FLOWN, markersize=3, alpha=0.5)
    inside = [good & (bins == each) for each in np.unique(bins[good])]
    axes.plot(
        [np.median(x[each]) for each in inside],
        [np.median(error[each]) for each in inside],
        "o" if _is_listed(values) else "o-",
        color=style.INK,
        markersize=4,
    )
    if not crashed.any():
        return  # empty, what is not clipped would break the layout
    axes.plot(
        x[crashed],
        np.ones(int(crashed.sum())),
        "x",
        transform=axes.get_xaxis_transform(),
        color=style.BOUND,
        markersize=5,
        alpha=0.8,
        clip_on=False,
    )


def _set_error_axis(axes: Axes, name: str, error: Array) -> None:
    """Make an axis logarithmic, with room for errors (n,) [m], and label it in plain numbers."""
    from matplotlib.ticker import LogLocator, NullLocator

    known = error[np.isfinite(error) & (error > 0.0)]
    if not len(known):
        return
    limits = (0.8 * known.min(), 1.4 * known.max())
    axes.set(**{f"{name}scale": "log", f"{name}lim": limits})
    axis = axes.xaxis if name == "x" else axes.yaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter("{x:g}")


def _title(figure: FigureBase, text: str, *, size: int = 10) -> None:
    figure.suptitle(text, x=0.01, ha="left", fontsize=size, color=style.INK)


def _counts(rows: Sequence[Row], flown: Sequence[Row]) -> str:
    kinds = Counter(row["crash"] for row in flown if row["crashed"])
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    share = f" ({100 * kinds.total() / len(flown):.3g} %: {counts})" if kinds else ""
    errors = len(rows) - len(flown)
    ended = f", {errors} ended with an error" if errors else ""
    return f"{len(rows)} flights, × {kinds.total()} crashed{share}{ended}"


def _target(campaign: Campaign, column: str) -> Target:
    """Return the parameter of a column; the column of a vector's element has its number too."""
    return campaign.targets.get(column) or campaign.targets[column.rpartition(".")[0]]


def _numbers(rows: Sequence[Row], name: str) -> Array:
    values = [row.get(name) for row in rows]
    return np.array([np.nan if value is None else float(value) for value in values])

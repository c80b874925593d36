"""The picture of a study: each objective against each other one."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.extras.campaigns.tuning.objectives import Objective
from quad_mpc_ros.extras.campaigns.tuning.trial import FLOWN, GIVEN_UP, Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAX_COLUMNS = 3
_WIDTH, _HEIGHT = 4.4, 3.8  # inch
_LOG_SCALE_RATIO = 4.0  # more than such a ratio is shown by its logarithm

_Values = tuple[list[float], list[float]]


def write_front(
    path: Path,
    *,
    trials: Sequence[Trial],
    front: Sequence[Trial],
    best: Trial,
    objectives: Sequence[Objective],
) -> None:
    """Draw all trials, the front, the start and what was chosen, as PNG.

    One objective alone is drawn over the trials. Raises ``OSError``.
    """
    pairs = [*itertools.combinations(range(len(objectives)), 2)] or [(-1, 0)]
    columns = min(len(pairs), _MAX_COLUMNS)
    rows = -(-len(pairs) // columns)
    figure = style.new_figure(_WIDTH * columns, _HEIGHT * rows + 0.4)
    measured = [trial for trial in trials if trial.objectives]
    for place, pair in enumerate(pairs, start=1):
        axes = figure.add_subplot(rows, columns, place)
        style.tidy(axes)
        axes.margins(0.05)
        _draw(axes, pair, measured, front)
        for trial, colour, marker, label in (
            (measured[0], style.REFERENCE, "D", "start"),
            (best, style.BOUND, "*", f"chosen, trial {best.number}"),
        ):
            size = 130 if marker == "*" else 45
            at = _values([trial], pair)
            axes.scatter(*at, s=size, c=colour, marker=marker, label=label, zorder=4)
        _scale(axes, pair, measured)
        across, up = (objectives[each].name if each >= 0 else "trial" for each in pair)
        axes.set_xlabel(across, fontsize=8, color=style.INK)
        axes.set_ylabel(up, fontsize=8, color=style.INK)
    handles, texts = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles,
        texts,
        loc="outside upper right",
        ncols=len(texts) if columns > 1 else 2,
        frameon=False,
        fontsize=8,
        labelcolor=style.INK,
    )
    style.save(figure, path)


def _draw(
    axes: Axes, pair: tuple[int, int], measured: Sequence[Trial], front: Sequence[Trial]
) -> None:
    given_up = [trial for trial in measured if trial.outcome == GIVEN_UP]
    flown = [trial for trial in measured if trial.outcome == FLOWN]
    if given_up:
        at = _values(given_up, pair)
        axes.scatter(*at, s=14, c=style.FAINT, marker="x", linewidths=0.8, label="given up")
    axes.scatter(*_values(flown, pair), s=16, c=style.FAINT, label="flown")
    axes.scatter(*_values(front, pair), s=26, c=style.FLOWN, label="front", zorder=3)
    for trial, x, y in zip(front, *_values(front, pair), strict=True):
        axes.annotate(
            str(trial.number),
            (x, y),
            textcoords="offset points",
            xytext=(4, 4),
            fontsize=6,
            color=style.INK,
        )


def _scale(axes: Axes, pair: tuple[int, int], measured: Sequence[Trial]) -> None:
    """Show by its logarithm what spans orders of magnitude."""
    from matplotlib.ticker import LogFormatter

    for values, set_scale, axis in zip(
        _values(measured, pair),
        (axes.set_xscale, axes.set_yscale),
        (axes.xaxis, axes.yaxis),
        strict=True,
    ):
        if min(values) > 0.0 and max(values) > _LOG_SCALE_RATIO * min(values):
            set_scale("log")
            # As plain numbers; those between the powers of ten where these are few.
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.6)))
            axis.set_tick_params(which="minor", labelsize=7, labelcolor=style.INK)


def _values(trials: Sequence[Trial], pair: tuple[int, int]) -> _Values:
    """Return the values of two objectives; -1 stands for the number of the trial."""
    across, up = (
        [trial.objectives[each] if each >= 0 else float(trial.number + 1) for trial in trials]
        for each in pair
    )
    return across, up

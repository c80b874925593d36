"""The figure of a study: pairs of objectives."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.extras.campaigns.tuning.objectives import FLOWN, GIVEN_UP, Objective, Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAX_COLUMNS = 3
_WIDTH, _HEIGHT, _LEGEND_HEIGHT = 4.4, 3.8, 0.6  # inch
_LOG_SCALE_RATIO = 4.0  # of the largest to the smallest value


def write_front(
    path: Path,
    *,
    trials: Sequence[Trial],
    front: Sequence[Trial],
    best: Trial,
    objectives: Sequence[Objective],
) -> None:
    """Draw all trials, the front, the first and the chosen trial as PNG.

    A single objective is drawn over the number of the trial. Raises ``OSError``.
    """
    names = ["trial", *(objective.name for objective in objectives)]
    pairs = list(itertools.combinations(range(1, len(names)), 2)) or [(0, 1)]
    columns = min(len(pairs), _MAX_COLUMNS)
    lines = -(-len(pairs) // columns)
    height = _HEIGHT * lines + _LEGEND_HEIGHT
    figure = style.new_figure(_WIDTH * columns, height)
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 1.0 - _LEGEND_HEIGHT / height))
    for place, (across, up) in enumerate(pairs, start=1):
        axes = figure.add_subplot(lines, columns, place)
        _draw_trials(axes, (across, up), trials, front, best)
        axes.set_xlabel(names[across], fontsize=8, color=style.INK)
        axes.set_ylabel(names[up], fontsize=8, color=style.INK)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=3, frameon=False, fontsize=8)
    style.save(figure, path)


def _draw_trials(
    axes: Axes,
    pair: tuple[int, int],
    trials: Sequence[Trial],
    front: Sequence[Trial],
    best: Trial,
) -> None:
    """Draw the trials at two of their values; numbers on the front are those of the files."""
    style.tidy(axes)
    axes.margins(0.05)
    for label, marker, size, colour, group in (
        (GIVEN_UP, "x", 4, style.FAINT, [each for each in trials if each.outcome == GIVEN_UP]),
        (FLOWN, "o", 4, style.FAINT, [each for each in trials if each.outcome == FLOWN]),
        ("front", "o", 5, style.FLOWN, front),
        ("trial 0, the start", "D", 6, style.REFERENCE, trials[:1]),
        (f"trial {best.number}, chosen", "*", 12, style.BOUND, [best]),
    ):
        points = np.reshape([_values(trial, pair) for trial in group], (-1, 2))
        axes.plot(*points.T, marker, color=colour, markersize=size, label=label)
    for trial in front:
        axes.annotate(
            str(trial.number),
            _values(trial, pair),
            xytext=(4, 4),
            textcoords="offset points",
            fontsize=6,
            color=style.INK,
        )
    shown = np.array([_values(trial, pair) for trial in trials if trial.objectives])
    for name, values in zip("xy", shown.T, strict=True):
        if 0.0 < _LOG_SCALE_RATIO * values.min() < values.max():
            style.use_log_scale(axes, name)


def _values(trial: Trial, pair: tuple[int, int]) -> tuple[float, float]:
    """Return two values of a trial: 0 is its number, the others are its objectives."""
    values = (float(trial.number), *trial.objectives)
    return values[pair[0]], values[pair[1]]

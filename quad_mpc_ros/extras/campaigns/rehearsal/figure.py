"""The picture of a rehearsal: which disturbed vehicles came back, and where the limits lie."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.extras.campaigns.rehearsal.rehearsal import VEHICLES, Limit, Rehearsal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH, _ROW_HEIGHT, _MARGIN_HEIGHT = 8.0, 1.05, 0.9  # inch


def write_rehearsal(path: Path, rehearsal: Rehearsal) -> Path:
    """Draw a row a direction, a mark a vehicle, as PNG. Raises ``OSError``."""
    limits = rehearsal.limits
    figure = style.new_figure(_WIDTH, _MARGIN_HEIGHT + _ROW_HEIGHT * len(limits), dpi=120)
    rows = figure.subplots(len(limits), 1, squeeze=False)[:, 0]
    for axes, limit in zip(rows, limits, strict=True):
        _draw(axes, limit)
    handles, labels = rows[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside upper right",
        ncols=len(labels),
        frameon=False,
        fontsize=8,
        labelcolor=style.INK,
    )
    return style.save(figure, path)


def _draw(axes: Axes, limit: Limit) -> None:
    """Draw the vehicles of a direction over how much they differ, its margin, what is needed."""
    direction = limit.direction
    scale, unit = (1e3, "ms") if direction.change == "plus" else (100.0, "%")
    style.tidy(axes)
    axes.axvspan(0.0, scale * limit.margin, color=style.FLOWN, alpha=0.08, linewidth=0.0)
    axes.axvline(
        scale * direction.ready,
        color=style.BOUND,
        linewidth=1.2,
        linestyle=(0, (5, 3)),
        label="needed to be ready",
    )
    for lost, colour, marker, label in (
        (False, style.FLOWN, "o", "came back"),
        (True, style.BOUND, "x", "lost"),
    ):
        places = np.array(
            [
                (scale * point.by, each.number)
                for point in limit.points
                for each in point.flown
                if bool(each.lost) is lost
            ]
        ).reshape(-1, 2)
        across, up = places.T
        axes.scatter(across, up, s=14, c=colour, marker=marker, linewidths=1.0, label=label)
    axes.set_xlim(-0.02 * scale * direction.most, 1.03 * scale * direction.most)
    axes.set_ylim(-1.0, VEHICLES)
    axes.set_yticks([])
    axes.set_ylabel("vehicles", fontsize=7, color=style.INK)
    title = f"{direction.name}: margin {limit.text}"
    axes.set_title(title, loc="left", fontsize=8.5, color=style.INK)
    axes.set_xlabel(f"difference from the guess [{unit}]", fontsize=7, color=style.INK, labelpad=1)

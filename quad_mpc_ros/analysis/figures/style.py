# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Style of all figures: size, axes, palette of Okabe and Ito (safe for colour blindness)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

FLOWN = "#0072B2"
REFERENCE = "#E69F00"
BOUND = "#D55E00"
INK = "#333333"
FAINT = "#B8B8B8"
GRID = "#E4E4E4"

_DPI = 200
_MARGIN = 0.05  # inch, around what is drawn in a cropped figure


def new_figure(width: float, height: float, *, dpi: int = _DPI) -> Figure:
    """Return a figure of a size [inch] that touches no global state of matplotlib."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=dpi, layout="constrained", facecolor="white")


def tidy(axes: Axes) -> None:
    """Give axes a light grid and only the spines that carry ticks."""
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.margins(x=0.01)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
    axes.tick_params(color=FAINT, labelcolor=INK, labelsize=8)


def use_log_scale(axes: Axes, name: str) -> None:
    """Make the axis ``x`` or ``y`` logarithmic, with plain numbers as labels."""
    from matplotlib.ticker import LogLocator, NullLocator

    axes.set(**{f"{name}scale": "log"})
    axis = axes.xaxis if name == "x" else axes.yaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter("{x:g}")


def title(axes: Axes, text: str) -> None:
    """Write a title above axes, on the left."""
    axes.set_title(text, loc="left", fontsize=11, color=INK, fontweight="bold", parse_math=False)


def legend(axes: Axes, *, above: float = 1.0) -> None:
    """Put the legend above a height of the axes, on the right, where the legend hides no curve."""
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        handles,
        labels,
        loc="lower right",
        bbox_to_anchor=(1.0, above),
        ncols=max(len(labels), 1),
        frameon=False,
        fontsize=8,
        borderaxespad=0.2,
        labelcolor=INK,
    )


def rgb(colour: str) -> tuple[float, float, float]:
    """Return the parts, 0 to 1, of a colour ``#RRGGBB``."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red / 255, green / 255, blue / 255


def save(figure: Figure, path: Path, *, cropped: bool = False) -> Path:
    """Write a figure as PNG, PDF or SVG, create missing folders, and return the path.

    A ``cropped`` figure has no white rows above and below.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    kind, part = path.suffix.removeprefix(".").lower(), _drawn_part(figure) if cropped else None
    figure.savefig(path, format=kind or "png", bbox_inches=part)
    return path


def _drawn_part(figure: Figure) -> Bbox:
    """Return the part [inch] of a figure from its first to its last drawn row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.transforms import Bbox

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    rows = np.flatnonzero((pixels < 255).any(axis=(1, 2)))
    top, bottom = (len(pixels) - rows[[0, -1]]) / figure.dpi + np.array([_MARGIN, -_MARGIN])
    return Bbox.from_extents(0.0, bottom, figure.get_figwidth(), top)

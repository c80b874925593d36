"""Panels drawn by matplotlib, and the figures of a flight."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.figures.panels import (
    Panel,
    attitude_panels,
    clearance_panels,
    input_panels,
    position_panels,
    velocity_panels,
)
from quad_mpc_ros.analysis.figures.path_figure import write_path
from quad_mpc_ros.recordings.flight import Flight

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_NAMES = ("position", "attitude", "velocity", "inputs", "path")

_WIDTH, _PANEL_HEIGHT, _MARGIN_HEIGHT = 8.0, 1.6, 0.7  # inch
_LINE_WIDTHS = {"normal": 1.3, "strong": 1.7, "broad": 2.2}  # points
_ABOVE, _BELOW, _LOWEST = 3, 2, 1


def write_figures(flight: Flight, directory: Path) -> list[Path]:
    """Draw a flight into ``directory`` (made if need be) and return the paths of the PNGs.

    ``position``, ``attitude``, ``velocity`` and ``inputs`` are Figures 4 to 7 of the paper, each
    against the reference; the last is left out of a flight without commands. ``clearance`` is the
    distance to obstacles, where there are any. ``path`` is the flight in
    space. Raises ``OSError`` when a file cannot be written.
    """
    figures = {
        "position": ("Position in the world", position_panels(flight)),
        "attitude": ("Attitude as a unit quaternion", attitude_panels(flight)),
        "velocity": ("Velocity in body axes", velocity_panels(flight)),
    }
    if len(flight.commands.stamp_ns):
        figures["inputs"] = ("Commanded throttle and body rates", input_panels(flight))
    if clearance := clearance_panels(flight):
        figures["clearance"] = ("Distance to obstacles", clearance)
    return [
        *(
            write_panels(title, panels, directory / f"{name}.png", gaps=flight.gaps)
            for name, (title, panels) in figures.items()
        ),
        write_path(flight, directory / "path.png"),
    ]


def write_panels(
    title: str, panels: Sequence[Panel], path: Path, *, gaps: Sequence[tuple[float, float]] = ()
) -> Path:
    """Draw panels below each other on one time axis into a PNG; raises ``OSError``.

    ``gaps`` are times without odometry [s], which are shaded.
    """
    figure = style.new_figure(_WIDTH, _MARGIN_HEIGHT + _PANEL_HEIGHT * len(panels))
    column = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(column, panels, strict=True):
        draw_panel(axes, panel)
        shade_gaps(axes, gaps)
    style.title(column[0], title)
    style.legend(column[0])
    label_time(column[-1])
    figure.align_ylabels(column)
    return style.save(figure, path)


def draw_panel(axes: Axes, panel: Panel, *, fontsize: float = 9) -> None:
    """Draw one panel; title, legend and the label of the time are left to the caller."""
    style.tidy(axes)
    for number, bound in enumerate(panel.bounds):
        axes.axhline(
            bound,
            label=panel.bound_name if number == 0 else None,
            color=style.BOUND,
            linewidth=0.9,
            linestyle=(0, (5, 3)),
            zorder=_LOWEST,
        )
    for curve in panel.curves:
        axes.plot(
            curve.time,
            curve.values,
            drawstyle="steps-post" if curve.held else "default",
            label=curve.name,
            color=curve.colour,
            linewidth=_LINE_WIDTHS[curve.weight],
            zorder=_BELOW if curve.weight == "broad" else _ABOVE,
        )
    if panel.logarithmic:
        axes.set_yscale("log")
    if panel.levels:
        axes.set_yticks(range(len(panel.levels)), panel.levels)
    axes.set_ylabel(_label(panel), fontsize=fontsize, color=style.INK)


def shade_gaps(axes: Axes, gaps: Sequence[tuple[float, float]]) -> None:
    """Shade times without odometry [s]."""
    for number, (begin, end) in enumerate(gaps):
        name = "no odometry" if number == 0 else None
        axes.axvspan(begin, end, color=style.FAINT, alpha=0.5, linewidth=0, label=name, zorder=0)


def label_time(axes: Axes) -> None:
    """Write below axes that they are over time."""
    axes.set_xlabel("time [s]", fontsize=9, color=style.INK)


def _label(panel: Panel) -> str:
    name = f"${panel.name}_{panel.subscript}$" if panel.subscript else panel.name
    return f"{name} [{panel.unit}]" if panel.unit else name

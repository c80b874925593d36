"""The figures of one flight: the paper's four over time, and the flight in space."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quad_mpc_ros.evaluation.flight import Flight
from quad_mpc_ros.figures import style
from quad_mpc_ros.figures.panels import (
    Panel,
    attitude_panels,
    draw,
    input_panels,
    position_panels,
    velocity_panels,
)
from quad_mpc_ros.figures.path_figure import write_path

FIGURE_NAMES = ("position", "attitude", "velocity", "inputs", "path")

_WIDTH, _PANEL_HEIGHT = 8.0, 1.6  # inch


def write_figures(flight: Flight, directory: Path) -> list[Path]:
    """Draw a flight into ``directory`` (made if need be) and return the paths of the PNGs.

    ``position``, ``attitude``, ``velocity`` and ``inputs`` are Figures 4 to 7 of the paper, each
    against the reference; the last is left out of a flight without commands. ``path`` is the
    flight in space. Raises ``OSError`` when a file cannot be written.
    """
    figures = {
        "position": ("Position in the world", position_panels(flight)),
        "attitude": ("Attitude as a unit quaternion", attitude_panels(flight)),
        "velocity": ("Velocity in body axes", velocity_panels(flight)),
    }
    if len(flight.commands.stamp_ns):
        figures["inputs"] = ("Commanded throttle and body rates", input_panels(flight))
    return [
        *(
            _write_panels(title, panels, directory / f"{name}.png")
            for name, (title, panels) in figures.items()
        ),
        write_path(flight, directory / "path.png"),
    ]


def _write_panels(title: str, panels: Sequence[Panel], path: Path) -> Path:
    """Draw panels below each other on one time axis."""
    figure = style.new_figure(_WIDTH, 0.7 + _PANEL_HEIGHT * len(panels))
    column = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(column, panels, strict=True):
        draw(axes, panel)
    style.title(column[0], title)
    style.legend(column[0])
    column[-1].set_xlabel("time [s]", fontsize=9, color=style.INK)
    figure.align_ylabels(column)
    return style.save(figure, path)

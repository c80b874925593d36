# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures over time of a flight, or of several flights next to each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros.analysis.figures import panels, style
from quad_mpc_ros.analysis.figures.panels import Panel
from quad_mpc_ros.analysis.figures.path_figure import write_path
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.recordings.evaluation.commanding import WITHOUT_MPC
from quad_mpc_ros.recordings.flight import Flight

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH, _MIN_COLUMN_WIDTH = 8.0, 6.0  # inch
_PANEL_HEIGHT, _MARGIN_HEIGHT = 1.6, 0.7  # inch
_LINE_WIDTH, _BROAD_WIDTH = 1.3, 2.2  # points
_ABOVE, _BELOW, _LOWEST = 3, 2, 1
_SHADES = {"no odometry": style.FAINT, "source other than mpc": style.REFERENCE}


@dataclass(frozen=True, kw_only=True)
class FlightFigure:
    """A figure over time; a flight with empty ``panels`` has no such figure."""

    name: str
    title: str
    panels: Callable[[Flight], list[Panel]]


RUN_FIGURES = (
    FlightFigure(name="position", title="Position in the world", panels=panels.position_panels),
    FlightFigure(
        name="attitude", title="Attitude as a unit quaternion", panels=panels.attitude_panels
    ),
    FlightFigure(name="velocity", title="Velocity in body axes", panels=panels.velocity_panels),
    FlightFigure(
        name="inputs", title="Commanded throttle and body rates", panels=panels.input_panels
    ),
    FlightFigure(name="clearance", title="Distance to obstacles", panels=panels.clearance_panels),
)
"""Figures of the folder of a run; the first four are Figures 4 to 7 of the paper."""


@dataclass(frozen=True, kw_only=True)
class PanelColumn:
    """Panels below each other, with shaded time spans, an array (k, 2) [s] for each label."""

    title: str
    panels: Sequence[Panel]
    shaded: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))


def write_figures(flight: Flight, directory: Path) -> list[Path]:
    """Draw a flight into a directory.

    Args:
        flight: The recorded flight.
        directory: The directory, created if missing.

    Returns:
        The paths of the PNG files: the available :data:`RUN_FIGURES`, and ``path.png``, the flight
        in space.

    Raises:
        OSError: A file cannot be written.
    """
    drawn = [
        write_flights(figure, {figure.title: flight}, directory / f"{figure.name}.png")
        for figure in RUN_FIGURES
        if figure.panels(flight)
    ]
    return [*drawn, write_path(flight, directory / "path.png")]


def write_flights(figure: FlightFigure, flights: Mapping[str, Flight], path: Path) -> Path:
    """Draw flights next to each other on common axes into a PNG.

    Args:
        figure: The figure, which all flights must have.
        flights: The flights, keyed by column title.
        path: The file to write.

    Raises:
        OSError: The file cannot be written.
    """
    columns = [
        PanelColumn(
            title=title,
            panels=figure.panels(flight),
            shaded={
                "no odometry": np.reshape(flight.gaps, (-1, 2)),
                "source other than mpc": spans_without_mpc(flight),
            },
        )
        for title, flight in flights.items()
    ]
    return write_panels(columns, path)


def spans_without_mpc(flight: Flight) -> Array:
    """Return the time spans (k, 2) [s] in which a failsafe commanded or nothing was published.

    A span lasts until the next tick of the MPC, or until the last odometry.
    """
    without = np.isin(flight.stats["source"], WITHOUT_MPC)
    edges = np.flatnonzero(np.diff(without, prepend=False, append=False))
    return np.asarray(np.append(flight.tick_time, flight.time[-1])[edges].reshape(-1, 2))


def write_panels(columns: Sequence[PanelColumn], path: Path) -> Path:
    """Draw columns of equally many panels on common axes into a PNG; raises ``OSError``."""
    rows, width = len(columns[0].panels), max(_WIDTH, _MIN_COLUMN_WIDTH * len(columns))
    figure = style.new_figure(width, _MARGIN_HEIGHT + _PANEL_HEIGHT * rows)
    grid = figure.subplots(rows, len(columns), sharex=True, sharey="row", squeeze=False)
    for axes_column, column in zip(grid.T, columns, strict=True):
        for axes, panel in zip(axes_column, column.panels, strict=True):
            draw_panel(axes, panel)
            _shade(axes, column.shaded)
        style.title(axes_column[0], column.title)
        style.legend(axes_column[0])
        label_time(axes_column[-1])
    figure.align_ylabels(grid[:, 0])
    return style.save(figure, path)


def draw_panel(axes: Axes, panel: Panel, *, fontsize: float = 9) -> None:
    """Draw one panel; the caller adds title, legend and the label of the time."""
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
            linewidth=_BROAD_WIDTH if curve.broad else _LINE_WIDTH,
            zorder=_BELOW if curve.broad else _ABOVE,
        )
    if panel.logarithmic:
        axes.set_yscale("log")
    if panel.levels:
        axes.set_yticks(range(len(panel.levels)), panel.levels)
    axes.set_ylabel(_label(panel), fontsize=fontsize, color=style.INK)


def _shade(axes: Axes, shaded: Mapping[str, Array]) -> None:
    for label, spans in shaded.items():
        if len(spans):
            axes.broken_barh(
                [(begin, end - begin) for begin, end in spans.tolist()],
                (0.0, 1.0),
                transform=axes.get_xaxis_transform(),
                color=_SHADES[label],
                alpha=0.3,
                linewidth=0,
                label=label,
                zorder=0,
            )


def label_time(axes: Axes) -> None:
    """Label the time axis below axes."""
    axes.set_xlabel("time [s]", fontsize=9, color=style.INK)


def _label(panel: Panel) -> str:
    name = f"${panel.name}_{panel.subscript}$" if panel.subscript else panel.name
    return f"{name} [{panel.unit}]" if panel.unit else name

"""Flights side by side: position and inputs, a column each, on common scales."""

from __future__ import annotations

from collections.abc import Mapping
from operator import add
from pathlib import Path

from quad_mpc_ros.evaluation.flight import Flight
from quad_mpc_ros.figures import style
from quad_mpc_ros.figures.panels import draw, input_panels, position_panels

_COLUMN_WIDTH, _PANEL_HEIGHT = 5.0, 1.3  # inch


def write_comparison(flights: Mapping[str, Flight], path: Path) -> Path:
    """Draw position and inputs of flights, by title, beside each other into one PNG.

    Raises ``OSError`` when it cannot be written.
    """
    position = [position_panels(flight) for flight in flights.values()]
    inputs = [input_panels(flight) for flight in flights.values()]
    first_input = len(position[0])
    rows = first_input + len(inputs[0])
    figure = style.new_figure(_COLUMN_WIDTH * len(flights), 0.7 + _PANEL_HEIGHT * rows)
    grid = figure.subplots(rows, len(flights), sharex=True, sharey="row", squeeze=False)
    for column, title, panels in zip(grid.T, flights, map(add, position, inputs), strict=True):
        for axes, panel in zip(column, panels, strict=True):
            draw(axes, panel)
            axes.label_outer()
        style.title(column[0], title)
        style.legend(column[0])
        style.legend(column[first_input])
        column[-1].set_xlabel("time [s]", fontsize=9, color=style.INK)
    figure.align_ylabels(grid[:, 0])
    return style.save(figure, path)

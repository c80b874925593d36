"""Panels over time as a Plotly figure, a column a run, on common axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.figures.panels import Curve, Panel
from quad_mpc_ros.analysis.report.plotting import plotly
from quad_mpc_ros.analysis.report.run import ReportedRun, Span, fallback_spans
from quad_mpc_ros.recordings.flight import Flight

MOST_POINTS = 6000  # of a curve; three for each pixel of a wide screen
MOST_SHADES = 200  # the longest times without the MPC

_MAX_DRAWN = 1e4  # m: too large to be drawn in single precision
_ROW_HEIGHT, _MARGINS = 130, 100  # pixels
# At the top left: the names of the runs stand below it, Plotly's buttons on the right.
_LEGEND = {"orientation": "h", "yref": "container", "y": 1.0, "yanchor": "top", "x": 0.0}
_LINE_WIDTHS = {"normal": 1.5, "strong": 2.0, "broad": 3.0}  # pixels
_NO_ODOMETRY = "no odometry"
_SPAN_COLOURS = {
    _NO_ODOMETRY: "#999999",
    "plan": "#F0E442",
    "hover": "#E69F00",
    "blind": "#D55E00",
    "silent": "#333333",
}


def time_figure(runs: Sequence[ReportedRun], panels_of: Callable[[Flight], list[Panel]]) -> Any:
    """Return the panels of runs beside each other, with what had no MPC or odometry shaded."""
    columns = [panels_of(run.flight) for run in runs]
    count = len(columns[0])
    figure = plotly("subplots").make_subplots(
        rows=count,
        cols=len(runs),
        column_titles=[escape(run.name) for run in runs] if len(runs) > 1 else None,
        shared_xaxes="all",
        shared_yaxes="rows",
        vertical_spacing=0.3 / (_ROW_HEIGHT * count / 100.0),
        horizontal_spacing=0.03,
    )
    shown: set[str] = set()
    for column, (run, panels) in enumerate(zip(runs, columns, strict=True), start=1):
        for row, panel in enumerate(panels, start=1):
            _draw(figure, panel, place={"row": row, "col": column}, shown=shown)
        figure.update_xaxes(title_text="time [s]", row=count, col=column)
        figure.layout.shapes += tuple(_shades(figure, run.flight, rows=count, column=column))
    for row, panel in enumerate(columns[0], start=1):
        figure.update_yaxes(title_text=label(panel), row=row, col=1)
    figure.update_layout(
        height=_MARGINS + _ROW_HEIGHT * count,
        template="plotly_white",
        margin={"t": 60, "l": 70, "r": 20, "b": 40},
        legend=_LEGEND,
        font={"color": style.INK, "size": 12},
        hovermode="x",
    )
    return figure


def label(panel: Panel) -> str:
    """Return what a panel shows, in Plotly's HTML."""
    name = f"{panel.name}<sub>{panel.subscript}</sub>" if panel.subscript else panel.name
    return f"{name} [{panel.unit}]" if panel.unit else name


def _draw(figure: Any, panel: Panel, *, place: dict[str, int], shown: set[str]) -> None:
    for curve in panel.curves:
        trace = _trace(curve.thinned(MOST_POINTS), in_legend=curve.name not in shown)
        figure.add_trace(trace, **place)
        shown.add(curve.name)
    for bound in panel.bounds:
        line = {"color": style.BOUND, "width": 1, "dash": "dash"}
        figure.add_hline(bound, line=line, **place)
    if panel.logarithmic:
        figure.update_yaxes(type="log", dtick=1, **place)
    if panel.levels:
        ticks = {"tickvals": list(range(len(panel.levels))), "ticktext": list(panel.levels)}
        figure.update_yaxes(range=[-0.5, len(panel.levels) - 0.5], **ticks, **place)


def _trace(curve: Curve, *, in_legend: bool) -> Any:
    values = curve.values
    is_far = bool((np.abs(values[np.isfinite(values)]) >= _MAX_DRAWN).any())
    return plotly("graph_objects").Scatter(
        x=curve.time,
        # Single precision is more than a screen has, and half the page.
        y=values if is_far else values.astype(np.float32),
        name=curve.name,
        legendgroup=curve.name,
        showlegend=in_legend,
        mode="lines" if len(curve.time) > 1 else "markers",
        line={
            "color": curve.colour,
            "width": _LINE_WIDTHS[curve.weight],
            "shape": "hv" if curve.held else "linear",
        },
        customdata=None if curve.hover is None else [escape(str(text)) for text in curve.hover],
        hovertemplate=f"%{{y:{'.3f' if is_far else '.4g'}}}"
        + ("" if curve.hover is None else " %{customdata}"),
    )


def _shades(figure: Any, flight: Flight, *, rows: int, column: int) -> list[dict[str, Any]]:
    """Return a rectangle for each time without the MPC or odometry in each row of a column."""
    missing = [
        Span(start=begin, end=end, source=_NO_ODOMETRY, reason="") for begin, end in flight.gaps
    ]
    longest = sorted(
        [*fallback_spans(flight), *missing], key=lambda span: (span.start - span.end, span.source)
    )
    return [
        {
            "type": "rect",
            "xref": subplot.xaxis.plotly_name.replace("axis", ""),
            "yref": subplot.yaxis.plotly_name.replace("axis", "") + " domain",
            "x0": span.start,
            "x1": span.end,
            "y0": 0,
            "y1": 1,
            "fillcolor": _SPAN_COLOURS[span.source],
            "opacity": 0.3,
            "line": {"width": 0},
            "layer": "below",
            "name": span.source,
        }
        for span in longest[:MOST_SHADES]
        for subplot in (figure.get_subplot(row, column) for row in range(1, rows + 1))
    ]

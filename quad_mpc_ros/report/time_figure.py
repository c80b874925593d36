"""Rows over time as a Plotly figure, a column a run, on common axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import numpy as np

from quad_mpc_ros.figures import style
from quad_mpc_ros.report.fallbacks import fallback_spans
from quad_mpc_ros.report.plotting import plotly
from quad_mpc_ros.report.row import Curve, Row
from quad_mpc_ros.report.run import ReportedRun

_ROW_HEIGHT, _MARGINS = 130, 100  # pixels
# At the top left: the names of the runs stand below it, Plotly's buttons on the right.
LEGEND = {"orientation": "h", "yref": "container", "y": 1.0, "yanchor": "top", "x": 0.0}
_SPAN_COLOURS = {"plan": "#F0E442", "hover": "#E69F00", "blind": "#D55E00", "silent": "#333333"}


def time_figure(runs: Sequence[ReportedRun], rows_of: Callable[[ReportedRun], list[Row]]) -> Any:
    """Return the rows of runs beside each other, with the times without the MPC shaded."""
    columns = [rows_of(run) for run in runs]
    count = len(columns[0])
    figure = plotly("subplots").make_subplots(
        rows=count,
        cols=len(runs),
        shared_xaxes="all",
        shared_yaxes="rows",
        vertical_spacing=0.3 / (_ROW_HEIGHT * count / 100.0),
        horizontal_spacing=0.03,
        column_titles=[escape(run.name) for run in runs] if len(runs) > 1 else None,
    )
    shown: set[str] = set()
    for column, (run, rows) in enumerate(zip(runs, columns, strict=True), start=1):
        for number, row in enumerate(rows, start=1):
            _draw(figure, row, place={"row": number, "col": column}, shown=shown)
        figure.update_xaxes(title_text="time [s]", row=count, col=column)
        figure.layout.shapes += tuple(_shades(figure, run, rows=count, column=column))
    for number, row in enumerate(columns[0], start=1):
        figure.update_yaxes(title_text=row.label, row=number, col=1)
    figure.update_layout(
        height=_MARGINS + _ROW_HEIGHT * count,
        template="plotly_white",
        hovermode="x",
        margin={"l": 70, "r": 20, "t": 60, "b": 40},
        legend=LEGEND,
        font={"color": style.INK, "size": 12},
    )
    return figure


def _draw(figure: Any, row: Row, *, place: dict[str, int], shown: set[str]) -> None:
    for curve in row.curves:
        figure.add_trace(_trace(curve, in_legend=curve.name not in shown), **place)
        shown.add(curve.name)
    for bound in row.bounds:
        line = {"color": style.BOUND, "width": 1, "dash": "dash"}
        figure.add_hline(bound, line=line, **place)
    if row.logarithmic:
        figure.update_yaxes(type="log", dtick=1, **place)
    if row.names:
        ticks = {"tickvals": list(range(len(row.names))), "ticktext": list(row.names)}
        figure.update_yaxes(range=[-0.5, len(row.names) - 0.5], **ticks, **place)


def _trace(curve: Curve, *, in_legend: bool) -> Any:
    return plotly("graph_objects").Scatter(
        x=curve.time,
        # Single precision is more than a screen has, and half the page.
        y=curve.values.astype(np.float32),
        name=curve.name,
        legendgroup=curve.name,
        showlegend=in_legend,
        mode="lines" if len(curve.time) > 1 else "markers",
        line={
            "color": curve.colour,
            "width": curve.width,
            "shape": "hv" if curve.held else "linear",
        },
        customdata=None if curve.hover is None else [escape(str(text)) for text in curve.hover],
        hovertemplate="%{y:.4g}" + ("" if curve.hover is None else " %{customdata}"),
    )


def _shades(figure: Any, run: ReportedRun, *, rows: int, column: int) -> list[dict[str, Any]]:
    """Return a rectangle for each time without the MPC in each row of a column."""
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
        for span in fallback_spans(run)
        for subplot in (figure.get_subplot(row, column) for row in range(1, rows + 1))
    ]

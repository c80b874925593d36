"""The page: one HTML file with its data, its style and Plotly inside; it loads nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from string import Template
from typing import Any

from quad_mpc_ros import __version__
from quad_mpc_ros.analysis.figures import panels
from quad_mpc_ros.analysis.report import overview
from quad_mpc_ros.analysis.report.markup import asset, in_script
from quad_mpc_ros.analysis.report.plotting import figure_html, plotly
from quad_mpc_ros.analysis.report.run import MOST_HORIZONS, ReportedRun
from quad_mpc_ros.analysis.report.series import TABLE_NAMES, csv_tables
from quad_mpc_ros.analysis.report.space_figure import space_figure
from quad_mpc_ros.analysis.report.time_figure import time_figure

MOST_ROWS = 30_000  # of a table in the page, ten minutes at 50 Hz; they take 15 MB
_COLUMN_WIDTH = 420  # pixels at least, of a run


@dataclass(frozen=True, kw_only=True)
class _Section:
    """A figure of the page; ``key`` names it in links and files."""

    key: str
    title: str
    text: str
    draw: Callable[[Sequence[ReportedRun]], Any]


_SECTIONS = (
    _Section(
        key="path",
        title="Path in space",
        text="Flown, coloured by speed, against the reference, with the positions that the "
        f"controller predicted: at most {MOST_HORIZONS} horizons, evenly chosen.",
        draw=space_figure,
    ),
    _Section(
        key="error",
        title="Tracking error",
        text="Distance and angle to the reference in force at each odometry.",
        draw=partial(time_figure, panels_of=panels.error_panels),
    ),
    _Section(
        key="position",
        title="Position in the world",
        text="Figure 4 of the paper.",
        draw=partial(time_figure, panels_of=panels.position_panels),
    ),
    _Section(
        key="attitude",
        title="Attitude as a unit quaternion",
        text="Figure 5 of the paper. A quaternion and its negative are the same attitude.",
        draw=partial(time_figure, panels_of=panels.attitude_panels),
    ),
    _Section(
        key="velocity",
        title="Velocity in body axes",
        text="Figure 6 of the paper: forward, left and up.",
        draw=partial(time_figure, panels_of=panels.velocity_panels),
    ),
    _Section(
        key="inputs",
        title="Commanded throttle and body rates",
        text="Figure 7 of the paper, with the bounds of the controller dashed.",
        draw=partial(time_figure, panels_of=panels.input_panels),
    ),
    _Section(
        key="solver",
        title="Solve time and iterations",
        text="Of every tick at which the solver ran; dashed is the control period.",
        draw=partial(time_figure, panels_of=panels.solver_panels),
    ),
    _Section(
        key="source",
        title="Who commanded",
        text="The rung of the safety ladder at each tick. Where it was not the MPC, every figure "
        "over time is shaded: yellow the last plan, orange hover, red blind, grey silent.",
        draw=partial(time_figure, panels_of=panels.source_panels),
    ),
)


def page(runs: Sequence[ReportedRun]) -> str:
    """Return the HTML of the report on at least one run.

    Raises :class:`UserError` when Plotly is not installed.
    """
    names = ", ".join(run.name for run in runs)
    return Template(asset("page.html")).substitute(
        title=escape(f"quad_mpc report: {names}"),
        style=asset("page.css"),
        plotly=plotly("offline").get_plotlyjs(),
        names=escape(names),
        version=escape(__version__),
        verdicts="\n".join(_verdict(run) for run in runs),
        identity=overview.identity_table(runs),
        metrics=overview.metrics_table(runs),
        links="\n".join(f'<a href="#{each.key}">{escape(each.title)}</a>' for each in _SECTIONS),
        sections="\n".join(_section(each, runs) for each in _SECTIONS),
        differences=_differences(runs),
        parameters=overview.parameter_table(runs, only_different=False)
        or "<p>None were recorded.</p>",
        buttons="\n".join(_buttons(run) for run in runs),
        tables=in_script({run.name: csv_tables(run) for run in runs if not _long(run)}),
        script=asset("page.js"),
    )


def _section(section: _Section, runs: Sequence[ReportedRun]) -> str:
    figure = figure_html(section.draw(runs), section.key)
    return (
        f'<section id="{section.key}"><h2>{escape(section.title)}</h2>\n'
        f"<p>{escape(section.text)}</p>\n"
        f'<div class="wide"><div style="min-width: {_COLUMN_WIDTH * len(runs)}px">{figure}</div>'
        "</div></section>"
    )


def _verdict(run: ReportedRun) -> str:
    summary = run.summary
    error = summary["position_rmse_m"]
    text = "" if error is None else f" Position error {error:.3g} m RMSE, "
    text += "" if error is None else f"{summary['position_max_m']:.3g} m at most."
    kind = "bad" if summary["fallbacks"] or not summary["commands"] else "good"
    return (
        f'<p class="{kind}"><b>{escape(run.name)}</b>: {summary["duration_s"]:.2f} s. '
        f"{escape(overview.verdict(run) + text)}</p>"
    )


def _differences(runs: Sequence[ReportedRun]) -> str:
    if len(runs) == 1:
        return ""
    table = overview.parameter_table(runs, only_different=True)
    return f"<h2>Parameters that differ</h2>\n{table or '<p>None.</p>'}"


def _long(run: ReportedRun) -> bool:
    """Whether a browser would have to carry too much with the tables of a run in the page."""
    return max(len(run.flight.stamp_ns), len(run.flight.tick_time)) > MOST_ROWS


def _buttons(run: ReportedRun) -> str:
    if _long(run):
        return f"<p>{escape(run.name)}: too long for a page, see quad_mpc report --csv.</p>"
    buttons = " ".join(
        f'<button data-run="{escape(run.name)}" data-table="{name}">{name}.csv</button>'
        for name in TABLE_NAMES
    )
    return f"<p>{escape(run.name)}: {buttons}</p>"

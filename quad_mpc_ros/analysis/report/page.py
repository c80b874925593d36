"""The page of recorded runs, beside each other."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from quad_mpc_ros.analysis.figures import panels
from quad_mpc_ros.analysis.figures.path_figure import write_path
from quad_mpc_ros.analysis.report import overview
from quad_mpc_ros.analysis.report.markup import (
    PageSection,
    bullets,
    folded,
    html_page,
    paragraph,
    verdict,
)
from quad_mpc_ros.analysis.report.plotting import figure_html
from quad_mpc_ros.analysis.report.run import ReportedRun
from quad_mpc_ros.analysis.report.time_figure import time_figure

_COLUMN_WIDTH = 420  # pixels at least, of a run
_HINT = (
    "Drag in a figure to zoom: every figure over time follows. Double-click to see all. "
    "The camera above a figure saves it as PNG; a click on the legend hides a curve."
)


@dataclass(frozen=True, kw_only=True)
class _Figure:
    """A figure of the page, of runs of which all have it; ``key`` names it in links and files."""

    key: str
    title: str
    text: str
    draw: Callable[[Sequence[ReportedRun]], Any]
    shown: Callable[[ReportedRun], bool] = lambda _: True


_FIGURES = (
    _Figure(
        key="error",
        title="Tracking error",
        text="Distance and angle to the reference in force at each odometry.",
        draw=partial(time_figure, panels_of=panels.error_panels),
    ),
    _Figure(
        key="clearance",
        title="Distance to obstacles",
        text="From the vehicle's surface to the nearest obstacle's, as it was and as far as the "
        "controller knew, and what it flew.",
        draw=partial(time_figure, panels_of=panels.clearance_panels),
        shown=lambda run: bool(panels.clearance_panels(run.flight)),
    ),
    _Figure(
        key="position",
        title="Position in the world",
        text="Figure 4 of the paper.",
        draw=partial(time_figure, panels_of=panels.position_panels),
    ),
    _Figure(
        key="attitude",
        title="Attitude as a unit quaternion",
        text="Figure 5 of the paper. A quaternion and its negative are the same attitude.",
        draw=partial(time_figure, panels_of=panels.attitude_panels),
    ),
    _Figure(
        key="velocity",
        title="Velocity in body axes",
        text="Figure 6 of the paper: forward, left and up.",
        draw=partial(time_figure, panels_of=panels.velocity_panels),
    ),
    _Figure(
        key="inputs",
        title="Commanded throttle and body rates",
        text="Figure 7 of the paper, with the bounds of the controller dashed.",
        draw=partial(time_figure, panels_of=panels.input_panels),
    ),
    _Figure(
        key="solver",
        title="Solve time and iterations",
        text="Of every tick at which the solver ran; dashed is the control period.",
        draw=partial(time_figure, panels_of=panels.solver_panels),
    ),
    _Figure(
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
    facts = [_in_words(run, alone=len(runs) == 1) for run in runs]
    facts += ["<h2>The runs</h2>", overview.identity_table(runs)]
    facts += ["<h2>Figures of merit</h2>", overview.metrics_table(runs), _differences(runs)]
    parameters = overview.parameter_table(runs, only_different=False)
    return html_page(
        names=[run.name for run in runs],
        verdicts=[_verdict(run) for run in runs],
        facts=facts,
        sections=[
            _paths(runs),
            *(_section(each, runs) for each in _FIGURES if all(map(each.shown, runs))),
        ],
        hint=_HINT,
        end=folded("Recorded parameters", parameters or paragraph("None were recorded.")),
    )


def _section(figure: _Figure, runs: Sequence[ReportedRun]) -> PageSection:
    box = _wide(figure_html(figure.draw(runs), figure.key), len(runs))
    return PageSection(key=figure.key, title=figure.title, parts=[paragraph(figure.text), box])


def _paths(runs: Sequence[ReportedRun]) -> PageSection:
    """Return the pictures of the flights in space, beside each other."""
    with tempfile.TemporaryDirectory() as folder:
        pictures = [write_path(run.flight, Path(folder, "path.png")).read_bytes() for run in runs]
    share = f"width: {100 / len(runs):.4g}%"
    images = "".join(
        f'<img style="{share}" alt="{escape(run.name)}" '
        f'src="data:image/png;base64,{base64.b64encode(picture).decode()}">'
        for run, picture in zip(runs, pictures, strict=True)
    )
    text = paragraph("Flown, coloured by speed, against the reference.")
    return PageSection(key="path", title="Path in space", parts=[text, _wide(images, len(runs))])


def _wide(content: str, columns: int) -> str:
    """Return a box that scrolls where it is too narrow for its columns."""
    width = f"min-width: {_COLUMN_WIDTH * columns}px"
    return f'<div class="wide"><div style="{width}">{content}</div></div>'


def _verdict(run: ReportedRun) -> str:
    summary = run.summary
    error = summary["position_rmse_m"]
    text = f"{summary['duration_s']:.2f} s. {run.verdict.line}"
    if error is not None:
        most = summary["position_max_m"]
        text += f" Position error {error:.3g} m RMSE, {most:.3g} m at most."
    if run.warning:
        text += f" {run.warning}."
    return verdict(run.name, text, good=run.verdict.good and not run.warning)


def _in_words(run: ReportedRun, *, alone: bool) -> str:
    """Return what the verdict says below its titles, folded away where there are several runs."""
    lists = [
        f"<h3>{escape(title)}</h3>\n{bullets(sentences)}"
        for title, sentences in run.verdict.sections.items()
    ]
    if alone:
        return PageSection(key="words", title="In words", parts=lists).html
    return folded(f"{run.name} in words", "\n".join(lists))


def _differences(runs: Sequence[ReportedRun]) -> str:
    if len(runs) == 1:
        return ""
    table = overview.parameter_table(runs, only_different=True)
    return f"<h2>Parameters that differ</h2>\n{table or '<p>None.</p>'}"

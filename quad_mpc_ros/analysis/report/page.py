# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""HTML page of recorded runs, next to each other."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from quad_mpc_ros import __version__
from quad_mpc_ros.analysis.figures import panels
from quad_mpc_ros.analysis.figures.over_time import RUN_FIGURES, FlightFigure, write_flights
from quad_mpc_ros.analysis.figures.path_figure import write_path
from quad_mpc_ros.analysis.report import overview
from quad_mpc_ros.analysis.report.run import ReportedRun

_FIGURES = (
    FlightFigure(name="error", title="Tracking error", panels=panels.error_panels),
    *RUN_FIGURES,
    FlightFigure(name="solver", title="Solve time and iterations", panels=panels.solver_panels),
    FlightFigure(name="source", title="Command source", panels=panels.source_panels),
)


def page(runs: Sequence[ReportedRun]) -> str:
    """Return a page of at least one run, with all figures and the style inside."""
    return Template(_asset("page.html")).substitute(
        names=escape(", ".join(run.name for run in runs)),
        style=_asset("page.css"),
        verdicts="\n".join(map(_verdict, runs)),
        sections="\n".join((*_overview(runs), *_figures(runs), _parameters(runs))),
        version=escape(__version__),
    )


def _verdict(run: ReportedRun) -> str:
    """Return one paragraph with the result of a run."""
    summary = run.summary
    text = f"{summary['duration_s']:.2f} s. {run.verdict.line}"
    if summary["position_rmse_m"] is not None:
        text += (
            f" Position error {summary['position_rmse_m']:.3g} m RMSE, "
            f"{summary['position_max_m']:.3g} m at most."
        )
    kind = "good" if run.verdict.good else "bad"
    return f'<p class="{kind}"><b>{escape(run.name)}</b>: {escape(text)}</p>'


def _overview(runs: Sequence[ReportedRun]) -> Iterator[str]:
    """Yield the sections before the figures."""
    words = (_in_words(run, unfolded=len(runs) == 1) for run in runs)
    yield _section("words", "Summary", words)
    yield _section("runs", "Runs", [overview.identity_table(runs)])
    yield _section("metrics", "Metrics", [overview.metrics_table(runs)])
    if len(runs) > 1:
        table = overview.parameter_table(runs, only_different=True)
        yield _section("differences", "Parameters that differ", [table or "<p>None.</p>"])


def _in_words(run: ReportedRun, *, unfolded: bool) -> str:
    sections = {
        "What went wrong": run.verdict.wrong,
        "What to do next": run.verdict.advice,
    }
    lists = "".join(
        f"<h3>{escape(title)}</h3>\n<ul>\n"
        + "\n".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
        + "\n</ul>\n"
        for title, sentences in sections.items()
        if sentences
    )
    opened = " open" if unfolded else ""
    return f"<details{opened}><summary>{escape(run.name)}</summary>\n{lists}</details>"


def _figures(runs: Sequence[ReportedRun]) -> Iterator[str]:
    """Yield the sections with figures that all runs have."""
    with tempfile.TemporaryDirectory() as folder:
        for name, title, images in run_figures(runs, Path(folder), "png"):
            yield _section(name, title, [_image(path, text) for path, text in images.items()])


def run_figures(
    runs: Sequence[ReportedRun], folder: Path, file_format: str
) -> Iterator[tuple[str, str, dict[Path, str]]]:
    """Draw the figures that all runs have; yield name, title, and files with their texts.

    ``file_format`` is ``png``, ``pdf`` or ``svg``. Raises ``OSError``.
    """
    paths = {folder / f"path_{run.name}.{file_format}": run for run in runs}
    drawn = {write_path(run.flight, path): run.name for path, run in paths.items()}
    yield "path", "Path in space", drawn
    flights = {run.name: run.flight for run in runs}
    for figure in _FIGURES:
        counts = {len(figure.panels(flight)) for flight in flights.values()}
        if len(counts) == 1 and counts != {0}:
            path = write_flights(figure, flights, folder / f"{figure.name}.{file_format}")
            yield figure.name, figure.title, {path: figure.title}


def _parameters(runs: Sequence[ReportedRun]) -> str:
    table = overview.parameter_table(runs, only_different=False)
    content = table or "<p>None were recorded.</p>"
    return f"<details><summary>Recorded parameters</summary>\n{content}</details>"


def _section(key: str, title: str, parts: Iterable[str]) -> str:
    content = "\n".join(parts)
    return f'<section id="{key}"><h2>{escape(title)}</h2>\n<div>{content}</div>\n</section>'


def _image(path: Path, text: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{data}">'


def _asset(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")

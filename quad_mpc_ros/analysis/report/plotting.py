"""Plotly, an extra of the package, imported when a page is made; and how its figures look."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from html import escape
from typing import Any

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.report.run import ReportedRun
from quad_mpc_ros.configuration import UserError

PLOTLY_NEEDED = "quad_mpc report draws with Plotly 6 or later: pip install 'quad_mpc_ros[report]'"
"""The message where Plotly is not installed, or too old."""

FAR = 1e4
"""Of a value [m]: too large to be drawn in single precision."""

_OLDEST = 6
# At the top left: the names of the runs stand below it, Plotly's buttons on the right.
_LEGEND = {"orientation": "h", "yref": "container", "y": 1.0, "yanchor": "top", "x": 0.0}


def plotly(module: str) -> Any:
    """Return a module of Plotly; Any, for it has no type hints.

    Raises :class:`UserError` when it is not installed or too old.
    """
    try:
        version = importlib.import_module("plotly").__version__
        if int(version.partition(".")[0]) < _OLDEST:
            raise UserError(f"Plotly {version} is installed. {PLOTLY_NEEDED}")
        return importlib.import_module(f"plotly.{module}")
    except ImportError as error:
        raise UserError(f"{error}. {PLOTLY_NEEDED}") from error


def subplots(rows: int, runs: Sequence[ReportedRun], *, titles: str, **options: Any) -> Any:
    """Return a figure with a column a run; its name is the ``titles`` of a column if several."""
    names = [escape(run.name) for run in runs] if len(runs) > 1 else None
    make_subplots = plotly("subplots").make_subplots
    return make_subplots(rows=rows, cols=len(runs), **{titles: names}, **options)


def lay_out(figure: Any, *, height: int, margin: dict[str, int], **options: Any) -> None:
    """Give a figure its height [pixels] and the look of the page."""
    figure.update_layout(
        height=height,
        template="plotly_white",
        margin={"t": 60, **margin},
        legend=_LEGEND,
        font={"color": style.INK, "size": 12},
        **options,
    )


def figure_html(figure: Any, key: str) -> str:
    """Return the element with a figure; its id is ``figure-`` and the key, its PNG ``key``.png."""
    return str(
        figure.to_html(
            full_html=False,
            include_plotlyjs=False,
            div_id=f"figure-{key}",
            config={
                "responsive": True,
                "displaylogo": False,
                "toImageButtonOptions": {"format": "png", "filename": key, "scale": 2},
            },
        )
    )

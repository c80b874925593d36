"""Plotly, an extra of the package, imported when a page is made."""

from __future__ import annotations

import importlib
from typing import Any

from quad_mpc_ros.configuration import UserError

PLOTLY_NEEDED = "quad_mpc report draws with Plotly 6 or later: pip install 'quad_mpc_ros[report]'"
"""The message where Plotly is not installed, or too old."""

_MIN_PLOTLY_MAJOR = 6


def plotly(module: str) -> Any:
    """Return a module of Plotly; Any, for it has no type hints.

    Raises :class:`UserError` when it is not installed or too old.
    """
    try:
        version = importlib.import_module("plotly").__version__
        if int(version.partition(".")[0]) < _MIN_PLOTLY_MAJOR:
            raise UserError(f"Plotly {version} is installed. {PLOTLY_NEEDED}")
        return importlib.import_module(f"plotly.{module}")
    except ImportError as error:
        raise UserError(f"{error}. {PLOTLY_NEEDED}") from error


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

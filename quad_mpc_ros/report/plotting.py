"""Plotly, which is an extra of the package: imported when a page is made, not before."""

from __future__ import annotations

import importlib
from typing import Any

from quad_mpc_ros.configuration import UserError

_HOW = "quad_mpc report draws with Plotly 6 or later: pip install 'quad_mpc_ros[report]'"
_OLDEST = 6


def plotly(module: str) -> Any:
    """Return a module of Plotly; Any, for it has no type hints.

    Raises :class:`UserError` when it is not installed or too old.
    """
    try:
        version = importlib.import_module("plotly").__version__
        if int(version.partition(".")[0]) < _OLDEST:
            raise UserError(f"Plotly {version} is installed. {_HOW}")
        return importlib.import_module(f"plotly.{module}")
    except ImportError as error:
        raise UserError(f"{error}. {_HOW}") from error

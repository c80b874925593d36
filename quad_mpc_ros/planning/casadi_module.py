"""CasADi, imported when a plan is made."""

from __future__ import annotations

import importlib
from typing import Any

from quad_mpc_ros.configuration import UserError


def casadi() -> Any:
    """Return the module; raises :class:`UserError` where it is not installed."""
    try:
        return importlib.import_module("casadi")
    except ImportError as error:
        raise UserError(
            "plan: CasADi is not installed, expected pip install casadi (the extra plan)"
        ) from error

"""CasADi, imported when a plan is made."""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
from typing import Any

from quad_mpc_ros.configuration import UserError

_WHEEL = "casadi==3.6.7"  # as acados' wheel has it, which replaces files of any other CasADi


def casadi() -> Any:
    """Return the module; raises :class:`UserError` where it cannot plan."""
    fault = casadi_fault()
    if fault is not None:
        raise UserError(f"plan: {fault}")
    return importlib.import_module("casadi")


@functools.cache
def casadi_fault() -> str | None:
    """Return why no race can be planned here, None if one can.

    The wheel of acados brings a CasADi without IPOPT, which replaces files of another one.
    """
    try:
        module = importlib.import_module("casadi")
    except ImportError:
        return "CasADi is not installed, expected pip install casadi (the extra plan)"
    version = str(module.__version__)
    try:
        installed = importlib.metadata.version("casadi")
    except importlib.metadata.PackageNotFoundError:
        installed = version
    if installed == version and module.has_nlpsol("ipopt"):
        return None
    replaced = "" if installed == version else f" in place of {installed}"
    return (
        f"given CasADi {version}{replaced}, of another package and without IPOPT (as acados' "
        f"wheel brings it), expected a whole one: pip install --force-reinstall --no-deps {_WHEEL}"
    )

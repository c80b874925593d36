# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""CasADi, imported for a plan."""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
from typing import Any

from quad_mpc_ros.configuration import UserError

_WHEEL = "casadi==3.6.7"  # the version in acados' wheel, which replaces files of other versions


def casadi() -> Any:
    """Return the module. Raises :class:`UserError` if CasADi cannot plan."""
    fault = casadi_fault()
    if fault is not None:
        raise UserError(f"plan: {fault}")
    return importlib.import_module("casadi")


@functools.cache
def casadi_fault() -> str | None:
    """Return the reason why no race can be planned, or None.

    The wheel of acados replaces files of an installed CasADi by a version without IPOPT.
    """
    try:
        module = importlib.import_module("casadi")
    except ImportError:
        return "CasADi is not installed; install it with: pip install casadi (the extra plan)"
    version = str(module.__version__)
    try:
        installed = importlib.metadata.version("casadi")
    except importlib.metadata.PackageNotFoundError:
        installed = version
    if installed == version and module.has_nlpsol("ipopt"):
        return None
    replaced = "" if installed == version else f" in place of {installed}"
    return (
        f"given CasADi {version}{replaced}, without IPOPT (from acados' wheel, for example), "
        f"expected a complete CasADi: pip install --force-reinstall --no-deps {_WHEEL}"
    )

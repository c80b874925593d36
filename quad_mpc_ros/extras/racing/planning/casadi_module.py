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


@functools.cache
def casadi() -> Any:
    """Return the module. Raises :class:`UserError` if CasADi cannot plan.

    The wheel of acados replaces files of an installed CasADi by a version without IPOPT.
    """
    try:
        module = importlib.import_module("casadi")
        installed = importlib.metadata.version("casadi")
    except ImportError as error:
        raise UserError(
            "plan: CasADi is not installed; install it with: pip install casadi (the extra plan)"
        ) from error
    if installed == module.__version__ and module.has_nlpsol("ipopt"):
        return module
    raise UserError(
        f"plan: given CasADi {module.__version__} (installed: {installed}), without IPOPT (from "
        "acados' wheel, for example), expected a complete CasADi: pip install --force-reinstall "
        f"--no-deps {_WHEEL}"
    )

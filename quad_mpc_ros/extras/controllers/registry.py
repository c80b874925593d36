# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Controllers by name: those of this package, of other packages, and ``module:Class``.

The table below names the controllers of this package. Other packages register theirs as entry
points of the group :data:`CONTROLLERS`.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.configuration.extension import registered, registered_names
from quad_mpc_ros.control.config import MPC, MpcConfig
from quad_mpc_ros.control.control_law import ControlLaw

CONTROLLERS = "quad_mpc_ros.controllers"
"""Group of the entry points of controllers."""

_PARAMETER = "mpc.controller"
_PACKAGE = "quad_mpc_ros.extras.controllers"
_OWN = {
    "geometric": f"{_PACKAGE}.geometric:GeometricController",
    "px4": f"{_PACKAGE}.px4:Px4Controller",
    "lqr": f"{_PACKAGE}.lqr:LqrController",
    "raptor": f"{_PACKAGE}.raptor:RaptorController",
}


def controller_names() -> list[str]:
    """Return the names of all controllers."""
    return [MPC, *_OWN, *sorted(registered_names(CONTROLLERS))]


def controller_class(name: str) -> Any:
    """Return the class of a controller, None for the MPC.

    Raises :class:`UserError` for an unknown name, and for a class that cannot be imported.
    """
    if name == MPC:
        return None
    place = _OWN.get(name, name)
    if ":" in place:
        return _imported(name, *place.split(":", maxsplit=1))
    found = registered(CONTROLLERS, name)
    if found is None:
        expected = f"one of {', '.join(controller_names())}, or module:Class"
        raise ConfigurationError(_PARAMETER, name, expected)
    return found


def configured_law(config: MpcConfig) -> ControlLaw:
    """Return a new controller of ``mpc.controller``, which is not the MPC.

    Raises :class:`UserError` for an unknown name, and if the controller cannot be created.
    """
    name, create = config.controller, controller_class(config.controller)
    try:
        law: Any = create(config)
    except UserError:
        raise
    except Exception as error:  # whatever the class raises
        reason = f"{type(error).__name__}: {error}"
        raise UserError(f"{_PARAMETER}: {name} cannot be created: {reason}") from error
    if not isinstance(law, ControlLaw):
        raise ConfigurationError(_PARAMETER, name, "a class with the methods reset and step")
    return law


def _imported(name: str, module: str, kind: str) -> Any:
    """Return a class of a module in the search path or in the working directory."""
    sys.path.append("")
    try:
        return getattr(importlib.import_module(module), kind)
    except Exception as error:  # whatever the module raises
        reason = f"{type(error).__name__}: {error}; check name, working directory, PYTHONPATH"
        raise UserError(f"{_PARAMETER}: {name} cannot be imported: {reason}") from error
    finally:
        sys.path.remove("")

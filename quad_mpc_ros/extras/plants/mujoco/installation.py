"""MuJoCo, imported when it is first needed."""

from __future__ import annotations

import importlib
from typing import Any

from quad_mpc_ros.configuration import UserError


def mujoco_module() -> Any:
    """Return the module ``mujoco``; raises :class:`UserError` where it is not installed."""
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise UserError(
            f"simulator.plant: mujoco cannot be imported ({error}); "
            "install it with: pip install 'quad_mpc_ros[mujoco]'"
        ) from error

"""MuJoCo, imported when it is first needed."""

from __future__ import annotations

import importlib
from typing import Any

from quad_mpc_ros.configuration import UserError


def mujoco_module() -> Any:
    """Return the module ``mujoco``; raises :class:`UserError` where it is not installed."""
    return _imported("mujoco", needed_by="simulator.plant")


def film_writer() -> Any:
    """Return ``imageio``'s face of version 2; raises :class:`UserError` where it is missing."""
    return _imported("imageio.v2", needed_by="--video")


def _imported(name: str, *, needed_by: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise UserError(
            f"{needed_by}: {name} cannot be imported ({error}); "
            "install it with: pip install 'quad_mpc_ros[mujoco]'"
        ) from error

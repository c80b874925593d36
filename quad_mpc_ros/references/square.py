# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's reference (section 2.2): a square of waypoints, each held for a while.

The corners in order, from the origin: east, north, west, and back; heading east throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import Chain, Path
from quad_mpc_ros.references.waypoints import Steps, StopParameters, rests_and_legs


@dataclass(frozen=True, kw_only=True)
class SquareParameters(StopParameters):
    """Parameters of the square."""

    side: float = parameter(2.0, doc="square: length of a side.", unit="m", above=0.0)


def square(config: SquareParameters) -> Steps:
    """Return the configured square, repeated."""
    return Steps(_corners(config), dwell_time=config.dwell_time, yaw=config.yaw)


def smooth_square(config: SquareParameters) -> Path:
    """Return the square with minimum-snap legs and a rest at each corner, repeated."""
    corners = _corners(config)
    return Chain(rests_and_legs(np.vstack((corners, corners[:1])), config), periodic=True)


def _corners(config: SquareParameters) -> Array:
    s, h = config.side, config.height
    corners = np.array([[0.0, 0.0, h], [s, 0.0, h], [s, s, h], [0.0, s, h]])
    return np.asarray(corners + np.array([*config.origin, 0.0]))

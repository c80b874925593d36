"""The paper's reference (section 2.2): a square of waypoints, each held for a while.

The corners in order, from the origin: east, north, west, and back; heading east throughout.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.lie import Array
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.path import Chain, Path, Round
from quad_mpc_ros.trajectories.waypoints import Steps, rests_and_legs


def square(config: ReferenceConfig) -> Steps:
    """Return the square of a configuration, round and round."""
    return Steps(_corners(config), dwell_time=config.dwell_time, yaw=config.yaw, closed=True)


def smooth_square(config: ReferenceConfig) -> Path:
    """Return the same square with legs of least snap, resting at each corner, for ever."""
    corners = _corners(config)
    return Round(Chain(rests_and_legs(np.vstack((corners, corners[:1])), config)))


def _corners(config: ReferenceConfig) -> Array:
    s, h = config.side, config.height
    corners = np.array([[0.0, 0.0, h], [s, 0.0, h], [s, s, h], [0.0, s, h]])
    return np.asarray(corners + np.array([*config.origin, 0.0]))

"""The paper's reference (section 2.2): a square of waypoints, each held for a while.

The corners in order, from the origin: east, north, west, and back; heading east throughout.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.waypoints import Steps


def square(config: ReferenceConfig) -> Steps:
    """Return the square of a configuration, round and round."""
    s, h = config.side, config.height
    corners = np.array([[0.0, 0.0, h], [s, 0.0, h], [s, s, h], [0.0, s, h]])
    return Steps(
        corners + np.array([*config.origin, 0.0]),
        dwell_time=config.dwell_time,
        yaw=config.yaw,
        closed=True,
    )

"""The path of a take-off, with a check of the axes close to the ground.

A hover hides reversed or swapped axes and a wrong heading of the odometry until the vehicle moves.
A small circle at a low height moves it in every direction: the consistency monitor of the MPC
(``control/safety/consistency.py``) finds the contradiction before the vehicle climbs further.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import End, leg_within
from quad_mpc_ros.references.path import Chain, CircularPath, Path
from quad_mpc_ros.references.smooth_turn import SmoothTurn

CHECK_HEIGHT, CHECK_RADIUS = 0.25, 0.03  # m above the ground, m
_CHECK_DURATION = 1.5  # s; peak acceleration 1.2 m/s^2


def take_off_path(
    p_WB: Array, *, height: float, checks: bool, max_speed: float, max_acceleration: float
) -> Path:
    """Return the path of a take-off from rest to rest.

    Args:
        p_WB: Position on the ground (3,) [m].
        height: Final height [m].
        checks: Whether the path contains the circle; not below the height of the circle.
        max_speed: Speed limit of the climb [m/s].
        max_acceleration: Acceleration limit of the climb [m/s^2].
    """

    def climb(start: Array, end: Array) -> Path:
        ends = End.at_rest(start), End.at_rest(end)
        return leg_within(*ends, max_speed=max_speed, max_acceleration=max_acceleration)

    above = np.array([*p_WB[:2], height])
    low = p_WB + np.array([0.0, 0.0, CHECK_HEIGHT])
    if not (checks and low[2] < height):
        return climb(p_WB, above)
    circle = CircularPath(
        low,
        forwards=np.array([0.0, 1.0, 0.0]),
        inwards=np.array([-1.0, 0.0, 0.0]),
        radius=CHECK_RADIUS,
        turn=SmoothTurn(math.tau, duration=_CHECK_DURATION),
    )
    return Chain([climb(p_WB, low), circle, climb(low, above)])

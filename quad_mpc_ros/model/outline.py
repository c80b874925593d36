"""The outline of the vehicle, for pictures: two beams and four rotors."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.lie import Array

ARM = 0.11
"""From the centre to a rotor [m]: the paper's 220 mm diagonal."""

_ROTOR_POINTS = 24


def outline(arm: float) -> tuple[Array, Array]:
    """Return the two beams (2, 2, 3) and the four rotors (4, points, 3) in the body frame [m]."""
    directions = np.radians([45.0, 135.0, 225.0, 315.0])
    hubs = arm * np.column_stack((np.cos(directions), np.sin(directions), np.zeros(4)))
    turn = np.linspace(0.0, 2.0 * np.pi, _ROTOR_POINTS, endpoint=False)
    disc = 0.6 * arm * np.column_stack((np.cos(turn), np.sin(turn), np.zeros(_ROTOR_POINTS)))
    return hubs[[[0, 2], [1, 3]]], hubs[:, None] + disc

"""Between ENU/FLU, in which the package computes, and NED/FRD, which aircraft stacks use.

REP-103 has both. World axes swap and turn: north-east-down (x, y, z) is east-north-up (y, x, -z).
Body axes forward-right-down are forward-left-up with y and z turned. Both maps are their own
inverse, so each function serves in both directions; the names say what comes out.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from quad_mpc_ros.control.lie import Array

_SQRT_HALF = math.sqrt(0.5)


def enu_from_ned(p_ned: Any) -> Array:
    """Return a world vector (3,) in east-north-up of one in north-east-down, or back."""
    north, east, down = map(float, p_ned)
    return np.array((east, north, -down))


def flu_from_frd(v_frd: Any) -> Array:
    """Return a body vector (3,) in forward-left-up of one in forward-right-down, or back."""
    forward, right, down = map(float, v_frd)
    return np.array((forward, -right, -down))


def q_enu_flu_xyzw_from_ned_frd_wxyz(q_ned_frd_wxyz: Any) -> Array:
    """Return the quaternion (x, y, z, w) of FLU in ENU for that (w, x, y, z) of FRD in NED.

    It is q(pi, 0, pi/2) q q(pi, 0, 0), roll, pitch and yaw, multiplied out and normalised.
    Raises ``ValueError`` when there is no rotation in it.
    """
    w, x, y, z = (float(value) for value in q_ned_frd_wxyz)
    length = math.hypot(w, x, y, z)
    if not 0.5 < length < 2.0:  # NaN compares with nothing
        raise ValueError(f"no rotation in the quaternion {[w, x, y, z]}")
    s = _SQRT_HALF / length
    return np.array((s * (x + y), s * (x - y), s * (w - z), s * (w + z)))

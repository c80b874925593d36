# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between ENU/FLU, used by this package, and NED/FRD, used by aircraft stacks.

REP-103 defines both. North-east-down (x, y, z) is east-north-up (y, x, -z); forward-right-down
(x, y, z) is forward-left-up (x, -y, -z). Both maps are their own inverse, so each function
works in both directions; its name states the result.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from quad_mpc_ros.control.lie import Array

_SQRT_HALF = math.sqrt(0.5)


def enu_from_ned(p_ned: Any) -> Array:
    """Return a world vector (3,) converted from NED to ENU, or back."""
    north, east, down = map(float, p_ned)
    return np.array((east, north, -down))


def flu_from_frd(v_frd: Any) -> Array:
    """Return a body vector (3,) converted from FRD to FLU, or back."""
    forward, right, down = map(float, v_frd)
    return np.array((forward, -right, -down))


def q_enu_flu_xyzw_from_ned_frd_wxyz(q_ned_frd_wxyz: Any) -> Array:
    """Return the quaternion (x, y, z, w) of FLU in ENU, given (w, x, y, z) of FRD in NED.

    The result is q(pi, 0, pi/2) q q(pi, 0, 0), in roll, pitch and yaw, multiplied out and
    normalised. Raises ``ValueError`` if the quaternion is not a rotation.
    """
    w, x, y, z = (float(value) for value in q_ned_frd_wxyz)
    length = math.hypot(w, x, y, z)
    if not 0.5 < length < 2.0:  # false also for NaN
        raise ValueError(f"quaternion: given {[w, x, y, z]}, expected a unit quaternion")
    s = _SQRT_HALF / length
    return np.array((s * (x + y), s * (x - y), s * (w - z), s * (w + z)))

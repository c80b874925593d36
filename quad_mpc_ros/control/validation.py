"""Is an input fit to be used? Each check returns the reason why not, or None."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.core.compiled import compiled
from quad_mpc_ros.core.messages import Array, OdometrySample, ReferenceWindow

_QUATERNION_TOLERANCE = 1e-3
_LARGEST = 1e8  # room for map coordinates in metres, none for what would overflow when squared


def odometry_fault(odometry: OdometrySample, *, frame_id: str) -> str | None:
    """Return why an odometry cannot be used, whatever came before it."""
    vectors = (odometry.p_WB, odometry.v_WB_B, odometry.w_WB_B)
    if not (_usable(odometry.q_WB_xyzw) and all(map(_usable, vectors))):
        return "odometry holds a number that is not finite or beyond 1e8"
    if not _are_unit(odometry.q_WB_xyzw[None]):
        return "odometry quaternion is not of unit length"
    if odometry.frame_id.removeprefix("/") != frame_id.removeprefix("/"):
        return f"odometry is in frame '{odometry.frame_id}', expected '{frame_id}'"
    return None


def reference_fault(window: ReferenceWindow, *, frame_id: str) -> str | None:
    """Return why a reference window cannot be used."""
    if len(window.offset_ns) == 0:
        return "reference is empty"
    if _run_backwards(window.offset_ns):
        return "reference times run backwards"
    vectors = (window.p_WB, window.q_WB_xyzw, window.v_WB_W, window.a_WB_W, window.w_WB_W)
    if not all(_usable(values.ravel()) for values in vectors):
        return "reference holds a number that is not finite or beyond 1e8"
    if not _are_unit(window.q_WB_xyzw):
        return "reference quaternion is not of unit length"
    if window.frame_id.removeprefix("/") != frame_id.removeprefix("/"):
        return f"reference is in frame '{window.frame_id}', expected '{frame_id}'"
    return None


def coverage_fault(window: ReferenceWindow, stamp_ns: int, *, tolerance_ns: int) -> str | None:
    """Return why a reference says nothing of a time: it is over, or still to begin."""
    begins_ns = window.stamp_ns + int(window.offset_ns[0])
    ends_ns = window.stamp_ns + int(window.offset_ns[-1])
    if stamp_ns - ends_ns > tolerance_ns:
        return f"reference ended {(stamp_ns - ends_ns) * 1e-9:.2f} s before the odometry's stamp"
    if begins_ns - stamp_ns > tolerance_ns:
        return f"reference begins {(begins_ns - stamp_ns) * 1e-9:.2f} s after the odometry's stamp"
    return None


@compiled
def _usable(values: Array) -> bool:
    """Whether all of (n,) are finite and of a size to compute with."""
    usable = True
    for value in values:
        usable &= abs(value) <= _LARGEST  # NaN compares with nothing, and so is not within it
    return usable


@compiled
def _are_unit(q_xyzw: Array) -> bool:
    """Whether quaternions (n, 4) are of unit length."""
    for i in range(len(q_xyzw)):
        square = 0.0
        for k in range(4):
            square += q_xyzw[i, k] ** 2
        if abs(math.sqrt(square) - 1.0) > _QUATERNION_TOLERANCE:
            return False
    return True


@compiled
def _run_backwards(times: NDArray[np.int64]) -> bool:
    backwards = False
    for i in range(1, len(times)):
        backwards |= times[i] < times[i - 1]
    return backwards

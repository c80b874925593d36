"""Is an input fit to be used? Each check returns the reason why not, or None."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.core.messages import Array, OdometrySample, ReferenceWindow

_QUATERNION_TOLERANCE = 1e-3
_LARGEST = 1e8  # room for map coordinates in metres, none for what would overflow when squared


def odometry_fault(
    odometry: OdometrySample, *, frame_id: str, newest_stamp_ns: int | None
) -> str | None:
    """Return why an odometry cannot be used, given the stamp of the last one that could."""
    vectors = (odometry.p_WB, odometry.q_WB_xyzw, odometry.v_WB_B, odometry.w_WB_B)
    if not _are_usable(*vectors):
        return "odometry holds a number that is not finite or beyond 1e8"
    if not _is_unit(odometry.q_WB_xyzw):
        return "odometry quaternion is not of unit length"
    if odometry.frame_id.removeprefix("/") != frame_id.removeprefix("/"):
        return f"odometry is in frame '{odometry.frame_id}', expected '{frame_id}'"
    if newest_stamp_ns is not None and odometry.stamp_ns < newest_stamp_ns:
        return "odometry stamp runs backwards"
    return None


def reference_fault(window: ReferenceWindow, *, frame_id: str) -> str | None:
    """Return why a reference window cannot be used."""
    if len(window.offset_ns) == 0:
        return "reference is empty"
    if np.any(np.diff(window.offset_ns) < 0):
        return "reference times run backwards"
    vectors = (window.p_WB, window.q_WB_xyzw, window.v_WB_W, window.a_WB_W, window.w_WB_W)
    if not _are_usable(*vectors):
        return "reference holds a number that is not finite or beyond 1e8"
    if not _is_unit(window.q_WB_xyzw):
        return "reference quaternion is not of unit length"
    if window.frame_id.removeprefix("/") != frame_id.removeprefix("/"):
        return f"reference is in frame '{window.frame_id}', expected '{frame_id}'"
    return None


def _are_usable(*vectors: Array) -> bool:
    # NaN compares with nothing, and so is not within the limit.
    return all(float(np.abs(vector).max()) <= _LARGEST for vector in vectors)


def _is_unit(q_xyzw: Array) -> bool:
    length = np.sqrt(np.sum(q_xyzw * q_xyzw, axis=-1))
    return bool(np.all(np.abs(length - 1.0) <= _QUATERNION_TOLERANCE))

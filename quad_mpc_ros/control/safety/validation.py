"""Is an input fit to be used? Each check returns the reason why not, or None."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow

_QUATERNION_TOLERANCE = 1e-3
_LARGEST = 1e8  # room for map coordinates in metres, none for what would overflow when squared

_FIT, _UNUSABLE, _NOT_UNIT, _BACKWARDS = 0, 1, 2, 3
_FAULTS = {
    _UNUSABLE: "holds a number that is not finite or beyond 1e8",
    _NOT_UNIT: "quaternion is not of unit length",
    _BACKWARDS: "times run backwards",
}


def odometry_fault(odometry: OdometrySample, *, frame_id: str) -> str | None:
    """Return why an odometry cannot be used, whatever came before it."""
    fault = _odometry_fault(odometry.p_WB, odometry.q_WB_xyzw, odometry.v_WB_B, odometry.w_WB_B)
    if fault != _FIT:
        return f"odometry {_FAULTS[fault]}"
    if not _is_frame(odometry.frame_id, frame_id):
        return f"odometry is in frame '{odometry.frame_id}', expected '{frame_id}'"
    return None


def reference_fault(window: ReferenceWindow, *, frame_id: str) -> str | None:
    """Return why a reference window cannot be used."""
    if len(window.offset_ns) == 0:
        return "reference is empty"
    fault = _reference_fault(
        window.offset_ns,
        window.p_WB,
        window.q_WB_xyzw,
        window.v_WB_W,
        window.a_WB_W,
        window.w_WB_W,
    )
    if fault != _FIT:
        return f"reference {_FAULTS[fault]}"
    if not _is_frame(window.frame_id, frame_id):
        return f"reference is in frame '{window.frame_id}', expected '{frame_id}'"
    return None


def pose_fault(
    *, frame_id: str, expected_frame_id: str, p_WB: Array, q_WB_xyzw: Array
) -> str | None:
    """Return why poses, positions (n, 3) and quaternions (n, 4), cannot be used."""
    if not _is_frame(frame_id, expected_frame_id):
        return f"it is in frame '{frame_id}', expected '{expected_frame_id}'"
    # Written so that NaN, which compares with nothing, is refused.
    if not ((np.abs(p_WB) <= _LARGEST).all() and (np.abs(q_WB_xyzw) <= _LARGEST).all()):
        return f"it holds a number that is not finite or beyond {_LARGEST:g}"
    if (np.abs(np.linalg.norm(q_WB_xyzw, axis=1) - 1.0) > _QUATERNION_TOLERANCE).any():
        return "it holds a quaternion that is not of unit length"
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


def _is_frame(given: str, expected: str) -> bool:
    return given == expected or given.removeprefix("/") == expected.removeprefix("/")


@compiled
def _odometry_fault(p_WB: Array, q_WB_xyzw: Array, v_WB_B: Array, w_WB_B: Array) -> int:
    """Return which fault the numbers have, all looked at in one call."""
    if not (_usable(p_WB) and _usable(q_WB_xyzw) and _usable(v_WB_B) and _usable(w_WB_B)):
        return _UNUSABLE
    return _FIT if _is_unit(q_WB_xyzw) else _NOT_UNIT


@compiled
def _reference_fault(
    offset_ns: NDArray[np.int64],
    p_WB: Array,
    q_WB_xyzw: Array,
    v_WB_W: Array,
    a_WB_W: Array,
    w_WB_W: Array,
) -> int:
    """Return the first fault of samples one after another, all looked at in one call."""
    for i in range(1, len(offset_ns)):
        if offset_ns[i] < offset_ns[i - 1]:
            return _BACKWARDS
    if not (
        _are_usable(p_WB)
        and _are_usable(q_WB_xyzw)
        and _are_usable(v_WB_W)
        and _are_usable(a_WB_W)
        and _are_usable(w_WB_W)
    ):
        return _UNUSABLE
    for q in q_WB_xyzw:
        if not _is_unit(q):
            return _NOT_UNIT
    return _FIT


@compiled
def _usable(values: Array) -> bool:
    """Whether all of (n,) are finite and of a size to compute with."""
    usable = True
    for value in values:
        usable &= abs(value) <= _LARGEST  # NaN compares with nothing, and so is not within it
    return usable


@compiled
def _are_usable(rows: Array) -> bool:
    """Whether all of (n, m) are."""
    usable = True
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            usable &= abs(rows[i, k]) <= _LARGEST
    return usable


@compiled
def _is_unit(q_xyzw: Array) -> bool:
    square = 0.0
    for k in range(4):
        square += q_xyzw[k] ** 2
    return abs(math.sqrt(square) - 1.0) <= _QUATERNION_TOLERANCE

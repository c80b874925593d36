# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Validation of reference windows, compiled because they are large and frequent."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.safety.validation import (
    LARGEST,
    NOT_UNIT,
    QUATERNION_TOLERANCE,
    is_frame,
    unusable_field,
)

_FIT, _UNUSABLE, _NOT_UNIT, _BACKWARDS = 0, 1, 2, 3
_FIELDS = (
    "points[{}].transforms[0].translation",
    "points[{}].transforms[0].rotation",
    "points[{}].velocities[0].linear",
    "points[{}].accelerations[0].linear",
    "points[{}].velocities[0].angular",
)
_FAULTS = {_NOT_UNIT: NOT_UNIT, _BACKWARDS: "times go backwards"}


def reference_fault(window: ReferenceWindow, *, frame_id: str) -> str | None:
    """Return why a reference window is unusable, None if it is usable."""
    if window.offset_ns.size == 0:
        return "reference is empty"
    samples = (window.p_WB, window.q_WB_xyzw, window.v_WB_W, window.a_WB_W, window.w_WB_W)
    fault = _reference_fault(window.offset_ns, *samples)
    if fault == _UNUSABLE:
        return f"reference {unusable_field(dict(zip(_FIELDS, samples, strict=True)))}"
    if fault != _FIT:
        return f"reference {_FAULTS[fault]}"
    if not is_frame(window.frame_id, frame_id):
        return f"reference is in frame '{window.frame_id}', expected '{frame_id}'"
    return None


@compiled
def _reference_fault(
    offset_ns: NDArray[np.int64],
    p_WB: Array,
    q_WB_xyzw: Array,
    v_WB_W: Array,
    a_WB_W: Array,
    w_WB_W: Array,
) -> int:
    """Return the first fault of the samples."""
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
    for i in range(len(q_WB_xyzw)):
        square = 0.0
        for q in q_WB_xyzw[i]:
            square += q * q
        if abs(math.sqrt(square) - 1.0) > QUATERNION_TOLERANCE:
            return _NOT_UNIT
    return _FIT


@compiled
def _are_usable(rows: Array) -> bool:
    """Whether all elements of an (n, m) array are finite and at most ``LARGEST``."""
    return kernels.infinity_norm(rows) <= LARGEST  # also false for NaN

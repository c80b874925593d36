# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The active corridor as a ``sensor_msgs/PointCloud2`` whose points are half-spaces.

A point is a half-space n' p <= b on the position at the end of a stage, with the fields ``stage``,
the unit vector ``normal_x``, ``normal_y``, ``normal_z``, and ``offset`` b [m], in the frame of the
header; the stamp is equal to the stamp of the constrained plan. Without points the space is free.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.messages.cdr import written_records
from quad_mpc_ros.messages.point_cloud import records_from_message

_NORMAL = ("normal_x", "normal_y", "normal_z")
_DRAWN_RADIUS = 1.0  # m, as far as a region is drawn
_MIN_DEPTH = 1e-3  # m, that the place has to be inside
_PLANE_TOLERANCE = 1e-6
_RECORD = np.dtype([("stage", "<u4"), *((name, "<f4") for name in _NORMAL), ("offset", "<f8")])


def written_corridor(corridor: Corridor | None, *, stamp_ns: int, frame_id: str) -> bytes:
    """Return the active rows of a corridor, with the stamp of a plan."""
    if corridor is None:
        return written_records(np.zeros(0, _RECORD), stamp_ns=stamp_ns, frame_id=frame_id)
    stage, row = np.nonzero(np.isfinite(corridor.offsets))
    records = np.zeros(len(stage), _RECORD)
    records["stage"], records["offset"] = stage, corridor.offsets[stage, row]
    for axis, name in enumerate(_NORMAL):
        records[name] = corridor.normals[stage, row, axis]
    return written_records(records, stamp_ns=stamp_ns, frame_id=frame_id)


def corridor_from_message(message: Any) -> NDArray[Any]:
    """Return the half-spaces (n,) of a message; ``ValueError`` for other point types."""
    records = records_from_message(message, _RECORD.names or ())
    return records.ravel() if records.dtype.names else np.zeros(0, _RECORD)


def corridor_edges(corridor: NDArray[Any], p_WB: Array) -> Array:
    """Return the edges (m, 2, 3) [m] of the region that constrains the end of a plan (n, 3)."""
    if not len(corridor):
        return np.zeros((0, 2, 3))
    last = corridor[corridor["stage"] == corridor["stage"].max()]
    normals = np.column_stack([last[name] for name in _NORMAL]).astype(np.float64)
    return edges(normals, last["offset"], inside=p_WB[-1], reach=_DRAWN_RADIUS)


def edges(normals: Array, offsets: Array, *, inside: Array, reach: float) -> Array:
    """Return the edges (m, 2, 3) [m] of n' p <= b, clipped at ``reach`` [m] from a position (3,).

    None if the position is not inside. ``normals`` are (k, 3), ``offsets`` (k,) [m].
    """
    from scipy.spatial import HalfspaceIntersection, QhullError  # for viewers only

    cube = np.vstack((np.eye(3), -np.eye(3)))
    n = np.vstack((normals, cube))
    b = np.concatenate((offsets, cube @ inside + reach))
    # Two corners of the same plane given twice would look like the ends of an edge.
    _, first = np.unique(np.column_stack((n, b)).round(3), axis=0, return_index=True)
    n, b = n[first], b[first]
    if (n @ inside > b - _MIN_DEPTH).any():
        return np.zeros((0, 2, 3))
    try:
        corners = HalfspaceIntersection(np.column_stack((n, -b)), inside).intersections
    except QhullError:
        return np.zeros((0, 2, 3))
    corners = np.unique(corners[np.isfinite(corners).all(axis=1)].round(6), axis=0)
    touching = np.abs(corners @ n.T - b) < 1e3 * _PLANE_TOLERANCE
    # Two corners on two planes at once are the ends of an edge.
    shared = touching.astype(np.int64) @ touching.T.astype(np.int64)
    begins, ends = np.nonzero(np.triu(shared >= 2, k=1))
    return np.stack((corners[begins], corners[ends]), axis=1)

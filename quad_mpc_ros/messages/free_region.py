"""The edges of the convex region inside half-spaces, for viewers."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.messages.corridor import HalfSpaces

_DRAWN_RADIUS = 1.0  # m, as far as a region is drawn
_MIN_DEPTH = 1e-3  # m, that the place has to be inside
_PLANE_TOLERANCE = 1e-6


def corridor_edges(corridor: HalfSpaces, p_WB: Array) -> Array:
    """Return the edges (m, 2, 3) [m] of the region that constrains the end of a plan (n, 3)."""
    if not len(corridor.stage):
        return np.zeros((0, 2, 3))
    normals, offsets = corridor.of_stage(int(corridor.stage.max()))
    return edges(normals, offsets, inside=p_WB[-1], reach=_DRAWN_RADIUS)


def edges(normals: Array, offsets: Array, *, inside: Array, reach: float) -> Array:
    """Return the edges (m, 2, 3) [m] of n' p <= b, clipped at ``reach`` [m] from a position (3,).

    None if the position is not inside. ``normals`` are (k, 3), ``offsets`` (k,) [m].
    """
    from scipy.spatial import HalfspaceIntersection, QhullError

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

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Half-spaces around a path: a convex free region for every stage of a horizon.

The region is inflated around the segment of the path that a stage covers, until it touches points
(Liu et al., "Planning dynamically feasible trajectories for quadrotors using safe flight corridors
in 3-D complex environments", RA-L 2017; here with a ball instead of an ellipsoid). The nearest
point q to the segment, with its foot f on the segment, defines the plane

    n = (q - f) / |q - f|,   n' p <= n' q - r

where r is the distance to keep. Points behind n' q need no further plane; the next nearest
remaining point follows. The segment is inside if its distance to every point is r or more.
Otherwise the plane is beyond the segment and pushes the plan back.

A stage has the planes of its own segment and of the next segment, so that the straight line
between two stages is in one convex region.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels

REACH = 2.5
"""Points further away from a segment define no plane [m]; no plan deviates that far."""


@compiled
def inflate(points: Array, guide: Array, radius: float, normals: Array, offsets: Array) -> None:
    """Write half-spaces (N, K, 3) and (N, K) around a path (N + 1, 3) among points (n, 3).

    ``radius`` is the distance to keep. Unused rows are not written.
    """
    count, most = offsets.shape
    points = _in_reach(points, guide)
    distances = np.empty(len(points))
    n, b, planes = np.empty((count, most, 3)), np.empty((count, most)), np.zeros(count, np.int64)
    for i in range(count):
        segment = kernels.vector(guide[i]), kernels.vector(guide[i + 1])
        planes[i] = _about(points, segment, radius, n[i], b[i], distances)
    for i in range(count):
        used = min(planes[i], (most + 1) // 2)
        normals[i, :used], offsets[i, :used] = n[i, :used], b[i, :used]
        if i + 1 < count:
            more = min(planes[i + 1], most - used)
            normals[i, used : used + more] = n[i + 1, :more]
            offsets[i, used : used + more] = b[i + 1, :more]


@compiled
def _in_reach(points: Array, guide: Array) -> Array:
    """Return the points (n, 3) within reach of the bounding box of the path."""
    kept, count = np.empty_like(points), 0
    x0, x1 = guide[:, 0].min() - REACH, guide[:, 0].max() + REACH
    y0, y1 = guide[:, 1].min() - REACH, guide[:, 1].max() + REACH
    z0, z1 = guide[:, 2].min() - REACH, guide[:, 2].max() + REACH
    for k in range(len(points)):
        x, y, z = kernels.vector(points[k])
        if x0 <= x <= x1 and y0 <= y <= y1 and z0 <= z <= z1:
            kernels.store_vector((x, y, z), kept[count])
            count += 1
    return kept[:count]


@compiled
def _about(
    points: Array,
    segment: tuple[kernels.Vector, kernels.Vector],
    radius: float,
    normals: Array,
    offsets: Array,
    distances: Array,
) -> int:
    """Write the planes around a segment, nearest first; return their number."""
    for k in range(len(points)):
        q = kernels.vector(points[k])
        d = kernels.minus(q, _foot(q, segment))
        squared = kernels.dot(d, d)
        distances[k] = squared if squared <= REACH * REACH else math.inf
    for row in range(len(offsets)):
        nearest, least = -1, math.inf
        for k in range(len(points)):
            if distances[k] < least:
                q = kernels.vector(points[k])
                if _is_behind(q, radius, normals[:row], offsets[:row]):
                    distances[k] = math.inf
                else:
                    nearest, least = k, distances[k]
        if nearest < 0:
            return row
        q = kernels.vector(points[nearest])
        n = _direction(_foot(q, segment), q)
        kernels.store_vector(n, normals[row])
        offsets[row] = kernels.dot(n, q) - radius
    return len(offsets)


@compiled
def _is_behind(q: kernels.Vector, radius: float, normals: Array, offsets: Array) -> bool:
    """Return whether a point is behind one of the planes."""
    for row in range(len(offsets)):
        if kernels.dot(kernels.vector(normals[row]), q) >= offsets[row] + radius - 1e-9:
            return True
    return False


@compiled
def _foot(q: kernels.Vector, segment: tuple[kernels.Vector, kernels.Vector]) -> kernels.Vector:
    """Return the nearest point of a segment to a point."""
    a, b = segment
    along = kernels.minus(b, a)
    length = kernels.dot(along, along)
    if length < 1e-18:
        return a
    share = kernels.clamp(kernels.dot(kernels.minus(q, a), along) / length, 0.0, 1.0)
    return kernels.plus(a, kernels.scaled(share, along))


@compiled
def _direction(start: kernels.Vector, end: kernels.Vector) -> kernels.Vector:
    """Return the unit vector between two points; down for equal points."""
    d = kernels.minus(end, start)
    length = kernels.norm(d)
    if length < 1e-9:
        return 0.0, 0.0, -1.0
    return kernels.scaled(1.0 / length, d)


def corridor_about(
    guide: Array, points: Array, *, radius: float, rows: int
) -> tuple[Array, Array]:
    """Return normals (N, K, 3) and offsets (N, K) around a path (N + 1, 3), K = ``rows``.

    ``radius`` [m] is the distance to keep from points (n, 3). Unused rows have zero normals and
    infinite offsets.
    """
    normals = np.zeros((len(guide) - 1, rows, 3))
    offsets = np.full((len(guide) - 1, rows), np.inf)
    if len(points) and rows:
        inflate(
            np.ascontiguousarray(points),
            guide=np.ascontiguousarray(guide),
            radius=radius,
            normals=normals,
            offsets=offsets,
        )
    return normals, offsets

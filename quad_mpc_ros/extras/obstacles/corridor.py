"""Half-spaces about a guide: a convex free region for every stage of a horizon.

About the segment of the guide that a stage covers the region is inflated until it touches points
(Liu et al., "Planning dynamically feasible trajectories for quadrotors using safe flight corridors
in 3-D complex environments", RA-L 2017; here with a ball in place of their ellipsoid): the nearest
point q to the segment, with its foot f on it, gives the plane

    n = (q - f) / |q - f|,   n' p <= n' q - r

where r is the distance to keep. All points behind n' q are then kept clear of and drop out, and
the next nearest follows. The segment itself is inside, as f is its nearest point to q, if it is r
away from every point. Where it is not, the plane is beyond the segment and pushes back.

A stage holds the planes of its own segment and of the next one, so that the straight way between
the ends of two stages is in one convex region.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels

REACH = 2.5
"""Points further than this from a segment give no plane [m]; no plan goes that far from it."""


@compiled
def inflate(points: Array, guide: Array, radius: float, normals: Array, offsets: Array) -> None:
    """Write half-spaces (N, K, 3) and (N, K) about a guide (N + 1, 3) among points (n, 3).

    The distance kept is ``radius``. Rows that stay unused keep what they hold: infinity.
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
    """Return those of points (n, 3) that are in reach of a box about the guide."""
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
    """Write the planes about a segment, the nearest first; return how many."""
    for k in range(len(points)):
        q = kernels.vector(points[k])
        d = kernels.plus(q, kernels.scaled(-1.0, _foot(q, segment)))
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
    """Whether a point is kept clear of by one of the planes."""
    for row in range(len(offsets)):
        if kernels.dot(kernels.vector(normals[row]), q) >= offsets[row] + radius - 1e-9:
            return True
    return False


@compiled
def _foot(q: kernels.Vector, segment: tuple[kernels.Vector, kernels.Vector]) -> kernels.Vector:
    """Return the point of a segment that is nearest to a point."""
    a, b = segment
    along = kernels.plus(b, kernels.scaled(-1.0, a))
    length = kernels.dot(along, along)
    if length < 1e-18:
        return a
    to_q = kernels.plus(q, kernels.scaled(-1.0, a))
    share = kernels.clamp(kernels.dot(to_q, along) / length, 0.0, 1.0)
    return kernels.plus(a, kernels.scaled(share, along))


@compiled
def _direction(start: kernels.Vector, end: kernels.Vector) -> kernels.Vector:
    """Return the unit vector between two points; up between equal ones, from below."""
    d = kernels.plus(end, kernels.scaled(-1.0, start))
    length = math.sqrt(kernels.dot(d, d))
    if length < 1e-9:
        return 0.0, 0.0, -1.0
    return kernels.scaled(1.0 / length, d)


def corridor_about(
    guide: Array, points: Array, *, radius: float, rows: int
) -> tuple[Array, Array]:
    """Return normals (N, K, 3) and offsets (N, K) of K ``rows`` a stage about a guide (N + 1, 3).

    Points (n, 3) are kept ``radius`` away from [m]. Rows that hold nothing have a zero normal and
    an infinite offset.
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

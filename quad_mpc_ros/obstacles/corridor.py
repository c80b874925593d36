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
from numpy.typing import NDArray

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
    own = (most + 1) // 2
    distances, near = np.empty(len(points)), np.empty(len(points), np.int64)
    for i in range(count):
        used = _about(
            points,
            (kernels.vector(guide[i]), kernels.vector(guide[i + 1])),
            radius,
            normals[i, :own],
            offsets[i, :own],
            distances,
            near,
        )
        if i + 1 < count:
            _about(
                points,
                (kernels.vector(guide[i + 1]), kernels.vector(guide[i + 2])),
                radius,
                normals[i, used:],
                offsets[i, used:],
                distances,
                near,
            )


@compiled
def _about(
    points: Array,
    segment: tuple[kernels.Vector, kernels.Vector],
    radius: float,
    normals: Array,
    offsets: Array,
    distances: Array,
    near: NDArray[np.int64],
) -> int:
    """Write the planes about a segment, the nearest first; return how many."""
    kept = _near_points(points, segment, distances, near)
    for row in range(len(offsets)):
        if kept == 0:
            return row
        nearest, least = 0, math.inf
        for k in range(kept):
            if distances[k] < least:
                nearest, least = k, distances[k]
        q = kernels.vector(points[near[nearest]])
        n = _direction(_foot(q, segment), q)
        touched = kernels.dot(n, q)
        kernels.store_vector(n, normals[row])
        offsets[row] = touched - radius
        left = 0
        for k in range(kept):
            p = kernels.vector(points[near[k]])
            if k != nearest and kernels.dot(n, p) < touched - 1e-9:
                distances[left], near[left] = distances[k], near[k]
                left += 1
        kept = left
    return len(offsets)


@compiled
def _near_points(
    points: Array,
    segment: tuple[kernels.Vector, kernels.Vector],
    distances: Array,
    near: NDArray[np.int64],
) -> int:
    """Write which points are near a segment, and their squared distances; return how many."""
    a, b = segment
    middle = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])
    half = kernels.plus(b, kernels.scaled(-1.0, middle))
    bound, kept = REACH + math.sqrt(kernels.dot(half, half)), 0
    for k in range(len(points)):
        x, y = points[k, 0] - middle[0], points[k, 1] - middle[1]
        z = points[k, 2] - middle[2]
        if x * x + y * y + z * z > bound * bound:
            continue
        q = kernels.vector(points[k])
        d = kernels.plus(q, kernels.scaled(-1.0, _foot(q, segment)))
        squared = kernels.dot(d, d)
        if squared <= REACH * REACH:
            distances[kept], near[kept] = squared, k
            kept += 1
    return kept


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

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Path search: a grid of distances to points, and A* on it, compiled."""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled, compiled_without_gil
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.obstacles.moving import Movers

_MAX_EXPANSIONS = 12_000
# Additional cost of a metre at the least permitted distance from points.
_PROXIMITY_COST = 1.5
# For unreachable goals: by how much a metre of path must reduce the distance to the goal.
_DETOUR_PENALTY = 0.3
# Cost of climbing over that of level flight: the ground is near, and pillars are high.
_CLIMB_COST_FACTOR = 1.5


class Grid(NamedTuple):
    """Distances (nx, ny, nz) [m] from cell centres to the nearest point, at most ``far``.

    Distances have single precision. ``origin`` (3,) is the centre of the first cell, ``cell`` the
    width of a cell [m].
    """

    distances: NDArray[np.float32]
    origin: Array
    cell: float
    far: float

    @staticmethod
    def about(centre: Array, *, half: tuple[float, float], cell: float, far: float) -> Grid:
        """Return an empty grid around a position with half extents (across, up) [m]."""
        across, up = (round(extent / cell) for extent in half)
        corner = np.floor(centre / cell) - (across, across, up)
        shape = 2 * across + 1, 2 * across + 1, 2 * up + 1
        return Grid(np.full(shape, far, np.float32), (corner + 0.5) * cell, cell, far)


class SearchBuffers(NamedTuple):
    """Buffers of a search for each cell, reused because allocation takes longer.

    Cost and length of the path to the cell, the preceding cell, and whether they are final.
    """

    cost: Array
    length: Array
    parent: NDArray[np.int32]
    closed: NDArray[np.bool_]

    @staticmethod
    def of(size: int) -> SearchBuffers:
        """Return buffers for a number of cells."""
        parent, closed = np.zeros(size, np.int32), np.zeros(size, np.bool_)
        return SearchBuffers(np.zeros(size), np.zeros(size), parent, closed)


@compiled_without_gil
def fill(points: Array, grid: Grid) -> None:
    """Write the distances to points (n, 3) into an empty grid."""
    nx, ny, nz = grid.distances.shape
    far, least = grid.far / grid.cell, grid.distances
    farthest = np.float32(far * far)
    least[:] = farthest  # squared, in cells
    for k in range(len(points)):
        x = (points[k, 0] - grid.origin[0]) / grid.cell
        y = (points[k, 1] - grid.origin[1]) / grid.cell
        z = np.float32((points[k, 2] - grid.origin[2]) / grid.cell)
        lowest, highest = max(0, math.ceil(z - far)), min(nz, math.floor(z + far) + 1)
        for i in range(max(0, math.ceil(x - far)), min(nx, math.floor(x + far) + 1)):
            for j in range(max(0, math.ceil(y - far)), min(ny, math.floor(y + far) + 1)):
                across = np.float32((i - x) ** 2 + (j - y) ** 2)
                if across >= farthest:
                    continue
                column = least[i, j]
                for m in range(lowest, highest):  # branch-free, so that it is vectorised
                    up = np.float32(m) - z
                    squared = across + up * up
                    column[m] = squared if squared < column[m] else column[m]
    for i in range(nx):
        for j in range(ny):
            for m in range(nz):
                least[i, j, m] = grid.cell * math.sqrt(least[i, j, m])


@compiled
def distance_at(grid: Grid, x: float, y: float, z: float) -> float:
    """Return the distance at a position, interpolated between cells; ``far`` outside."""
    nx, ny, nz = grid.distances.shape
    u = (x - grid.origin[0]) / grid.cell
    v = (y - grid.origin[1]) / grid.cell
    w = (z - grid.origin[2]) / grid.cell
    if not (0.0 <= u < nx - 1 and 0.0 <= v < ny - 1 and 0.0 <= w < nz - 1):
        return grid.far
    i, j, k = int(u), int(v), int(w)
    u, v, w = u - i, v - j, w - k
    d, total = grid.distances, 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                share = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if c else 1.0 - w)
                total += share * d[i + a, j + b, k + c]
    return total


@compiled
def is_clear(grid: Grid, start: Array, end: Array, keep: float) -> bool:
    """Return whether the line between two positions (3,) keeps a distance from points."""
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    count = math.ceil(math.sqrt(dx * dx + dy * dy + dz * dz) / (0.5 * grid.cell)) + 1
    for k in range(count + 1):
        s = k / count
        if distance_at(grid, start[0] + s * dx, start[1] + s * dy, start[2] + s * dz) < keep:
            return False
    return True


@compiled
def _cell_of(grid: Grid, place: Array) -> tuple[int, int, int]:
    """Return the nearest cell of the grid to a position."""
    shape = grid.distances.shape
    return (
        min(max(round((place[0] - grid.origin[0]) / grid.cell), 0), shape[0] - 1),
        min(max(round((place[1] - grid.origin[1]) / grid.cell), 0), shape[1] - 1),
        min(max(round((place[2] - grid.origin[2]) / grid.cell), 0), shape[2] - 1),
    )


@compiled
def _collides(movers: Movers, x: float, y: float, z: float, time: float) -> bool:
    """Return whether a moving ball is too near to a position at a time [s] from now."""
    for k in range(len(movers.keep)):
        dx = movers.p_W[k, 0] + time * movers.v_W[k, 0] - x
        dy = movers.p_W[k, 1] + time * movers.v_W[k, 1] - y
        dz = movers.p_W[k, 2] + time * movers.v_W[k, 2] - z
        keep = movers.keep[k] + movers.growth * time
        if dx * dx + dy * dy + dz * dz < keep * keep:
            return True
    return False


@compiled
def search(
    grid: Grid,
    start: Array,
    goal: Array,
    keep: float,
    floor: float,
    speed: float,
    movers: Movers,
    workspace: SearchBuffers,
) -> tuple[NDArray[np.float64], bool]:
    """Return a path (n, 3) of cells, and whether it reaches the goal.

    The path keeps the distance ``keep`` from points and from balls that move while it is flown at
    ``speed``, and stays above ``floor``. From a closer start the path first leads away from
    obstacles. If the goal is unreachable, the path ends near the goal, preferably in front.
    """
    nx, ny, nz = grid.distances.shape
    start_cell, goal_cell = _cell_of(grid, start), _cell_of(grid, goal)
    cost, length, parent, closed = workspace
    cost[:], closed[:] = np.inf, False
    flat = grid.distances.reshape(len(cost))
    first = (start_cell[0] * ny + start_cell[1]) * nz + start_cell[2]
    last = (goal_cell[0] * ny + goal_cell[1]) * nz + goal_cell[2]
    cost[first], length[first], parent[first] = 0.0, 0.0, -1
    queue = [(0.0, first)]
    best, least, expanded = first, math.inf, 0
    while len(queue) > 0 and expanded < _MAX_EXPANSIONS:
        _, at = heapq.heappop(queue)
        if closed[at]:
            continue
        closed[at] = True
        expanded += 1
        i, j, k = at // (ny * nz), (at // nz) % ny, at % nz
        left = _weighted_length(goal_cell[0] - i, goal_cell[1] - j, goal_cell[2] - k)
        left += _DETOUR_PENALTY * cost[at]
        if left < least:
            best, least = at, left
        if at == last:
            break
        for a in range(max(i - 1, 0), min(i + 2, nx)):
            for b in range(max(j - 1, 0), min(j + 2, ny)):
                for c in range(max(k - 1, 0), min(k + 2, nz)):
                    to = (a * ny + b) * nz + c
                    if closed[to]:
                        continue
                    distance = flat[to]
                    z = grid.origin[2] + c * grid.cell
                    if (distance < keep and distance <= flat[at]) or (z < floor and c <= k):
                        continue
                    step = _weighted_length(a - i, b - j, c - k)
                    nearness = max(0.0, (grid.far - distance) / (grid.far - keep))
                    reached = cost[at] + step * (1.0 + _PROXIMITY_COST * min(nearness, 2.0))
                    if reached >= cost[to]:
                        continue
                    straight = math.sqrt((a - i) ** 2 + (b - j) ** 2 + (c - k) ** 2)
                    if len(movers.keep) > 0:
                        x, y = grid.origin[0] + a * grid.cell, grid.origin[1] + b * grid.cell
                        time = (length[at] + straight) * grid.cell / speed
                        if _collides(movers, x, y, z, time):
                            continue
                    cost[to], parent[to], length[to] = reached, at, length[at] + straight
                    ahead = _weighted_length(goal_cell[0] - a, goal_cell[1] - b, goal_cell[2] - c)
                    heapq.heappush(queue, (reached + ahead, to))
    count, at = 1, best
    while parent[at] >= 0:
        count, at = count + 1, parent[at]
    path, at = np.empty((count, 3)), best
    for n in range(count - 1, -1, -1):
        path[n, 0] = grid.origin[0] + (at // (ny * nz)) * grid.cell
        path[n, 1] = grid.origin[1] + ((at // nz) % ny) * grid.cell
        path[n, 2] = grid.origin[2] + (at % nz) * grid.cell
        at = parent[at]
    return path, best == last


@compiled
def _weighted_length(x: int, y: int, z: int) -> float:
    """Return the length of a step, with a higher weight of climbing."""
    return math.sqrt(x * x + y * y + (_CLIMB_COST_FACTOR * z) ** 2)


@compiled
def shortened(
    grid: Grid, path: Array, keep: float, speed: float, movers: Movers
) -> NDArray[np.float64]:
    """Return the corners (m, 3) of a path shortened by straight lines.

    The lines keep the same distances as in :func:`search`.
    """
    corners = np.empty_like(path)
    corners[0] = path[0]
    count, at, time = 1, 0, 0.0
    while at < len(path) - 1:
        to = at + 1
        for k in range(len(path) - 1, at + 1, -1):
            if is_clear(grid, path[at], path[k], keep) and not _segment_collides(
                movers, path[at], path[k], time, speed, grid.cell
            ):
                to = k
                break
        leg = path[to] - path[at]
        time += math.sqrt(leg[0] ** 2 + leg[1] ** 2 + leg[2] ** 2) / speed
        corners[count] = path[to]
        count, at = count + 1, to
    return corners[:count].copy()


@compiled
def _segment_collides(
    movers: Movers, start: Array, end: Array, begun: float, speed: float, step: float
) -> bool:
    """Return whether a line between positions, started at a time [s], meets a moving ball."""
    if len(movers.keep) == 0:
        return False
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    count = math.ceil(length / step) + 1
    for k in range(count + 1):
        s = k / count
        x, y, z = start[0] + s * dx, start[1] + s * dy, start[2] + s * dz
        if _collides(movers, x, y, z, begun + s * length / speed):
            return True
    return False

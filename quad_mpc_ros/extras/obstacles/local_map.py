# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Map of static obstacles around the vehicle: a KD-tree of points and a distance grid.

The map is built in the control step or in another thread.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.obstacles.search import Grid, fill
from quad_mpc_ros.extras.obstacles.voxels import VoxelMap, local_origin
from quad_mpc_ros.extras.obstacles.world import ObstacleWorld

VOXEL_SIZE = 0.1
"""Size of the voxels, with one point each [m]."""

_CELL_SIZE = 0.2  # m
_MAX_VERTICAL_RANGE = 2.4  # m, greatest height difference of paths
_MAX_REUSE_DISTANCE = 1.0  # m, to the centre of a map
_STALE_DISTANCE = 2.0  # m, to the centre of a map while another one is built


class LocalMap:
    """Points (n, 3) around a centre, at a revision of the obstacles."""

    def __init__(
        self, points: Array, *, centre: Array, radius: float, far: float, revision: int
    ) -> None:
        """Build from points within a ``radius``; distances are resolved up to ``far`` [m]."""
        thinned, origin = VoxelMap(VOXEL_SIZE), local_origin(centre)
        thinned.insert((points - origin).astype(np.float32), 0)
        self.points = np.ascontiguousarray(thinned.points + origin)
        self.centre, self.radius, self.revision = centre.copy(), radius, revision
        self.far = far
        self._tree = None
        if len(self.points):  # few queries: fast to build, not balanced
            self._tree = cKDTree(self.points, balanced_tree=False, compact_nodes=False)
        self._grid: Grid | None = None
        self.is_searched = False
        """Whether the grid was used."""

    def distances(self, places: Array) -> Array:
        """Return the distances (n,) [m] of positions (n, 3) to the nearest points, or infinity."""
        if self._tree is None:
            return np.full(len(places), np.inf)
        return np.asarray(self._tree.query(places)[0])

    def are_clear(self, places: Array, keep: float) -> NDArray[np.bool_]:
        """Return which positions (n, 3) are at least ``keep`` [m] away from all points."""
        if self._tree is None:
            return np.ones(len(places), dtype=np.bool_)
        return np.isinf(self._tree.query(places, distance_upper_bound=keep)[0])

    @property
    def grid(self) -> Grid:
        """The distance grid, computed on first use."""
        self.is_searched = True
        return self._grid or self.make_grid()

    def make_grid(self) -> Grid:
        """Compute the distance grid."""
        half = self.radius, min(_MAX_VERTICAL_RANGE, self.radius)
        grid = Grid.about(self.centre, half=half, cell=_CELL_SIZE, far=self.far)
        fill(self.points, grid)
        self._grid = grid
        return grid


class _MapRequest(NamedTuple):
    """The last requested map: position (3,), time and size."""

    p_W: Array
    stamp_ns: int
    radius: float
    far: float


class LocalMapProvider:
    """Provides a :class:`LocalMap` of static obstacles around the vehicle.

    A map is valid until the obstacles or the requested range change, or the vehicle has moved by a
    metre. Then :meth:`at` builds the next map. With a ``wake``, :meth:`at` calls it and returns
    the previous map, up to two metres away, until another thread has called :meth:`update_map`.
    That thread also computes the grid if paths are searched.
    """

    def __init__(self, obstacles: ObstacleWorld) -> None:
        self._obstacles = obstacles
        self._map: LocalMap | None = None
        self._oldest_revision = obstacles.revision  # older maps are in other coordinates
        self._request: _MapRequest | None = None
        self.wake: Callable[[], None] | None = None
        """Called in the control step if a new map is required."""

    def at(self, p_W: Array, stamp_ns: int, *, radius: float, far: float) -> LocalMap:
        """Return the map around a position (3,) within ``radius``, distances to ``far`` [m]."""
        local, request = self._map, _MapRequest(p_W.copy(), stamp_ns, radius, far)
        self._request = request
        if local is not None and local.revision >= self._oldest_revision:
            if self._is_valid_for(local, request):
                return local
            if self.wake is not None and local.far >= far and _moved(local, p_W) < _STALE_DISTANCE:
                self.wake()
                return local
        return self._build(request)

    def update_map(self) -> None:
        """Build the next map, if required."""
        local, request = self._map, self._request
        if request is not None and (local is None or not self._is_valid_for(local, request)):
            self._build(request, with_grid=local is not None and local.is_searched)

    def forget(self) -> None:
        """Discard the map: coordinates change with this revision of the obstacles.

        A map that another thread is building from an earlier revision is not used.
        """
        self._map, self._oldest_revision = None, self._obstacles.revision

    def _is_valid_for(self, local: LocalMap, request: _MapRequest) -> bool:
        return (
            local.revision == self._obstacles.revision
            and local.radius == request.radius
            and local.far >= request.far
            and _moved(local, request.p_W) < _MAX_REUSE_DISTANCE
        )

    def _build(self, request: _MapRequest, *, with_grid: bool = False) -> LocalMap:
        revision = self._obstacles.revision
        points = self._obstacles.points(request.stamp_ns, near=request.p_W, radius=request.radius)
        built = LocalMap(
            points, centre=request.p_W, radius=request.radius, far=request.far, revision=revision
        )
        if with_grid:
            built.make_grid()
        self._map = built
        return built


def _moved(local: LocalMap, p_W: Array) -> float:
    return float(np.linalg.norm(p_W - local.centre))

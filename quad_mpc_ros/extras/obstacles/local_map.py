"""Map of static obstacles around the vehicle: a KD-tree of points and a distance grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.obstacles.search import Grid, fill
from quad_mpc_ros.extras.obstacles.voxels import VoxelMap, local_origin

VOXEL_SIZE = 0.1
"""Size of the voxels, with one point each [m]."""

_CELL_SIZE = 0.2  # m
_MAX_VERTICAL_RANGE = 2.4  # m, greatest height difference of paths


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

"""What stands around the vehicle, ready for questions: a KD-tree of points and a grid."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.obstacles.search import Grid, fill
from quad_mpc_ros.obstacles.voxels import VoxelMap

THINNED = 0.1
"""Side of the cubes of each of which one point is kept [m]."""

_CELL = 0.2  # m
_UP = 2.4  # m, that ways lead up or down at most
_MOVED = 1.0  # m, after which the surroundings are others


class LocalMap:
    """Points (n, 3) around a centre, as they were at a revision of what is known."""

    def __init__(
        self, points: Array, *, centre: Array, radius: float, far: float, revision: int
    ) -> None:
        """Take points within a ``radius``; of distances beyond ``far`` [m] nothing depends."""
        thinned = VoxelMap(THINNED)
        thinned.insert(points.astype(np.float32), 0)
        self.points = np.ascontiguousarray(thinned.points, dtype=np.float64)
        self.centre, self.radius, self.revision = centre.copy(), radius, revision
        self._far = far
        self._tree = None
        if len(
            self.points
        ):  # asked a few times only: a tree that is made soon, not a balanced one
            self._tree = cKDTree(self.points, balanced_tree=False, compact_nodes=False)
        self._grid: Grid | None = None

    def serves(self, p_W: Array, *, revision: int) -> bool:
        """Whether it is still what is around a place (3,)."""
        moved = float(np.linalg.norm(p_W - self.centre))
        return revision == self.revision and moved < _MOVED

    def distances(self, places: Array) -> Array:
        """Return the distances (n,) [m] of places (n, 3) to the nearest points, or infinity."""
        if self._tree is None:
            return np.full(len(places), np.inf)
        return np.asarray(self._tree.query(places)[0])

    @property
    def grid(self) -> Grid:
        """The grid of distances, made when it is first asked for."""
        if self._grid is None:
            half = self.radius, min(_UP, self.radius)
            self._grid = Grid.about(self.centre, half=half, cell=_CELL, far=self._far)
            fill(self.points, self._grid)
        return self._grid

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Voxel filter: one point per cube of a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled_without_gil
from quad_mpc_ros.control.lie import Array

_CELL_BITS = 21  # of a cube's coordinate, which wraps around
_MIXER = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio: Fibonacci hashing
_ORIGIN_SPACING = 1024.0  # m

Points = NDArray[np.float32]


def local_origin(p_W: Array) -> Array:
    """Return an origin (3,) [m] near a position, for accurate 32-bit coordinates.

    Near the world's origin it is 0. In 32 bit, coordinates of 5.4e6 m have a resolution of 0.5 m.
    """
    return np.asarray(_ORIGIN_SPACING * np.round(p_W / _ORIGIN_SPACING))


@compiled_without_gil
def _last_of_each(keys: NDArray[np.uint64], table: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return which keys (n,) are the last of their value.

    ``table`` has a power of two of entries, more than n, all -1.
    """
    last, most = np.zeros(len(keys), np.bool_), np.uint64(len(table) - 1)
    for k in range(len(keys) - 1, -1, -1):
        place = (keys[k] * _MIXER) >> np.uint64(32) & most
        while table[place] >= 0 and keys[table[place]] != keys[k]:
            place = (place + np.uint64(1)) & most
        if table[place] < 0:
            table[place], last[k] = k, True
    return last


class VoxelMap:
    """The newest point in each cube and its time."""

    def __init__(self, size: float) -> None:
        """Initialise with the size of a cube [m]."""
        self._per_metre = np.float32(1.0 / size)
        self.clear()

    def clear(self) -> None:
        """Remove all points."""
        self.points: Points = np.zeros((0, 3), np.float32)
        """The points (n, 3) [m]; a new array after each change."""
        self._last_seen_ns = np.zeros(0, np.int64)

    def move(self, points: Points) -> None:
        """Set new coordinates (n, 3) [m] of the same points."""
        self.points = points

    def insert(self, points: Points, stamp_ns: int) -> None:
        """Add finite points (n, 3) [m], replacing those of the same cubes."""
        points = np.concatenate((self.points, points))
        stamps_ns = np.full(len(points), stamp_ns)
        stamps_ns[: len(self.points)] = self._last_seen_ns
        keys = np.zeros(len(points), np.int64)
        for coordinate in points.T:
            cells = np.floor(coordinate * self._per_metre).astype(np.int32)
            keys <<= _CELL_BITS
            keys |= cells & ((1 << _CELL_BITS) - 1)
        table = np.full(2 << len(points).bit_length(), -1, np.int32)
        kept = _last_of_each(keys.view(np.uint64), table)
        self.points, self._last_seen_ns = points[kept], stamps_ns[kept]

    def forget_before(self, stamp_ns: int) -> bool:
        """Remove points last detected before a time; return whether any were removed."""
        stays = self._last_seen_ns >= stamp_ns
        if stays.all():
            return False
        self.points, self._last_seen_ns = self.points[stays], self._last_seen_ns[stays]
        return True

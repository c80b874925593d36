# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Voxel filter: one point per cube of a grid, in time proportional to the number of points."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array

_TABLE_BITS = 18  # of the hash table
_CELL_BITS = 21  # of a cube's coordinate, which wraps around
_MIXER = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio: Fibonacci hashing
_ORIGIN_SPACING = 1024.0  # m

Points = NDArray[np.float32]


def local_origin(p_W: Array) -> Array:
    """Return an origin (3,) [m] near a position, for accurate 32-bit coordinates.

    Near the world's origin it is 0. In 32 bit, coordinates of 5.4e6 m have a resolution of 0.5 m.
    """
    return np.asarray(_ORIGIN_SPACING * np.round(p_W / _ORIGIN_SPACING))


class _VoxelPoints(NamedTuple):
    """Points (n, 3) [m], their last detections [ns], keys of their cubes, and hashes."""

    points: Points
    last_seen_ns: NDArray[np.int64]
    keys: NDArray[np.int64]
    places: NDArray[np.intp]

    def chosen(self, which: NDArray[Any]) -> _VoxelPoints:
        return _VoxelPoints(*(column[which] for column in self))

    def with_more(self, other: _VoxelPoints) -> _VoxelPoints:
        columns: Any = zip(self, other, strict=True)
        return _VoxelPoints(*map(np.concatenate, columns))


class VoxelMap:
    """The last point in each cube and its time.

    A table has the last point of each hash. A point replaces only points of the same cube: for
    cubes with equal hash some redundant points remain, but no required point is lost.
    """

    def __init__(self, size: float) -> None:
        """Initialise with the size of a cube [m]."""
        self._per_metre = np.float32(1.0 / size)
        self._table = np.zeros(1 << _TABLE_BITS, dtype=np.int32)
        self._stored = self._voxelized(np.zeros((0, 3), np.float32), 0)

    @property
    def points(self) -> Points:
        """The points (n, 3) [m]; a new array after each change."""
        return self._stored.points

    def clear(self) -> None:
        """Remove all points."""
        self._stored = self._voxelized(np.zeros((0, 3), np.float32), 0)

    def move(self, points: Points) -> None:
        """Set new coordinates (n, 3) [m] of the same points."""
        last_seen_ns = self._stored.last_seen_ns
        self._store(self._voxelized(points, 0)._replace(last_seen_ns=last_seen_ns))

    def insert(self, points: Points, stamp_ns: int) -> None:
        """Add finite points (n, 3) [m], replacing those of the same cubes."""
        new, stored = self._voxelized(points, stamp_ns), self._stored
        if len(stored.points):
            before = np.minimum(self._table[new.places], len(stored.points) - 1)
            given_up = before[stored.keys[before] == new.keys]
            stays = np.ones(len(stored.points), dtype=bool)
            stays[given_up] = False
            stored = stored.chosen(stays)
        numbers = np.arange(len(points), dtype=np.int32)
        self._table[new.places] = numbers  # the last of equal hashes counts
        last = self._table[new.places]
        kept = (last == numbers) | (new.keys[last] != new.keys)
        self._store(stored.with_more(new.chosen(kept)))

    def forget_before(self, stamp_ns: int) -> bool:
        """Remove points last detected before a time; return whether any were removed."""
        stays = self._stored.last_seen_ns >= stamp_ns
        if stays.all():
            return False
        self._store(self._stored.chosen(stays))
        return True

    def _store(self, stored: _VoxelPoints) -> None:
        self._table[stored.places] = np.arange(len(stored.points), dtype=np.int32)
        self._stored = stored

    def _voxelized(self, points: Points, stamp_ns: int) -> _VoxelPoints:
        mask, keys = (1 << _CELL_BITS) - 1, np.zeros(len(points), dtype=np.int64)
        for coordinate in points.T:
            cells = np.floor(coordinate * self._per_metre).astype(np.int32)
            keys <<= _CELL_BITS
            keys |= cells & mask
        hashed = (keys.view(np.uint64) * _MIXER) >> np.uint64(64 - _TABLE_BITS)
        last_seen_ns = np.full(len(points), stamp_ns, dtype=np.int64)
        return _VoxelPoints(points, last_seen_ns, keys, hashed.astype(np.intp))

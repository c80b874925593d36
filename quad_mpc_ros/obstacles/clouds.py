"""The points of clouds: scans that are forgotten after a time, or a map that stays."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.config import ObstacleParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.messages.point_cloud import PointCloud
from quad_mpc_ros.obstacles.frames import Frames
from quad_mpc_ros.obstacles.voxels import Points, VoxelMap

_LATE = 1.0  # s before the newest odometry


class Clouds:
    """Takes clouds, in a thread of its own if need be, and has their points."""

    def __init__(self, config: ObstacleParameters, frames: Frames) -> None:
        self._config, self._frames = config, frames
        self._lock = threading.Lock()
        self._voxels = VoxelMap(config.resolution)
        self._forget_ns = round(1e9 * config.forget_after)
        self._newest_ns: int | None = None
        self._revision = 0

    @property
    def revision(self) -> int:
        """A number that grows with what is known."""
        return self._revision

    @property
    def is_heard(self) -> bool:
        """Whether a cloud has come."""
        return self._newest_ns is not None

    @property
    def _is_map(self) -> bool:
        return self._config.clouds == "map"

    def receive(self, cloud: PointCloud) -> None:
        """Take a cloud. Raises ``ValueError``, and is as if it had not come, if it is of no use.

        A scan has to be stamped within a second before the newest odometry; of a map the stamp
        does not count.
        """
        newest_ns = self._frames.newest_ns
        if newest_ns is None:
            raise ValueError("a cloud, and no odometry yet, by which it could be placed")
        late = 1e-9 * (newest_ns - cloud.stamp_ns)
        if late > _LATE and not self._is_map:
            raise ValueError(f"a cloud stamped {late:.3f} s before the newest odometry")
        stamp_ns = newest_ns if self._is_map and abs(late) > _LATE else cloud.stamp_ns
        points = self._frames.pose(cloud.frame_id, stamp_ns).applied(cloud.p_SQ)
        if not self._is_map:
            body = self._frames.body_pose(stamp_ns).p
            points = points[_within(points, body, self._config.range)]
        with self._lock:
            if self._is_map:
                self._voxels.clear()
            self._voxels.insert(points.astype(np.float32, copy=False), stamp_ns)
            self._newest_ns = max(stamp_ns, self._newest_ns or stamp_ns)
            self._revision += 1

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._voxels.clear()
            self._newest_ns = None
            self._revision += 1

    def forget(self, now_ns: int) -> None:
        """Forget what was last seen too long ago."""
        with self._lock:
            if not self._is_map and self._voxels.forget_before(now_ns - self._forget_ns):
                self._revision += 1

    @property
    def points(self) -> Points:
        """The points (n, 3) [m]."""
        with self._lock:
            return self._voxels.points

    def age(self, stamp_ns: int) -> float:
        """Return how old the newest scan is [s]; 0 when all are forgotten, and for a map."""
        age = self.silence(stamp_ns)
        return age if age <= self._config.forget_after else 0.0

    def silence(self, stamp_ns: int) -> float:
        """Return how long no scan has come [s]; 0 for a map, and before the first."""
        newest_ns = self._newest_ns
        if self._is_map or newest_ns is None:
            return 0.0
        return 1e-9 * max(stamp_ns - newest_ns, 0)


def _within(points: Points | Array, centre: Array, radius: float) -> NDArray[np.bool_]:
    """Return which points (n, 3) lie within a radius of a centre (3,)."""
    x, y, z = points.T
    cx, cy, cz = centre.astype(points.dtype)
    square = (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2
    return np.asarray(square <= radius * radius)

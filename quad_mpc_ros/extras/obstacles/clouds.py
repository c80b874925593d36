# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Points of clouds: scans that expire, or a permanent map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.config import ObstacleParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.extras.obstacles.frames import Frames, Pose
from quad_mpc_ros.extras.obstacles.voxels import Points, VoxelMap, local_origin
from quad_mpc_ros.messages.point_cloud import PointCloud

_MAX_SCAN_AGE = 1.0  # s before the newest odometry


class Placement(NamedTuple):
    """The transform of cloud points to the world frame.

    ``pose`` of the cloud's frame and position ``body`` (3,) [m] of the vehicle are relative to
    ``origin`` (3,) [m].
    """

    stamp_ns: int
    pose: Pose
    body: Array
    origin: Array


class Clouds:
    """The points of clouds as 32-bit numbers relative to ``origin`` (3,) [m].

    The origin is near the vehicle at the first cloud.
    """

    def __init__(self, config: ObstacleParameters, frames: Frames) -> None:
        self._config, self._frames = config, frames
        self._voxels = VoxelMap(config.resolution)
        self._forget_ns = round(1e9 * config.forget_after)
        self._newest_ns: int | None = None
        self.origin = np.zeros(3)
        self.revision = 0
        """A number that increases with each change."""

    @property
    def has_cloud(self) -> bool:
        """Whether a cloud was received."""
        return self._newest_ns is not None

    @property
    def points(self) -> Points:
        """The points (n, 3) [m] relative to ``origin``; a new array after each change."""
        return self._voxels.points

    @property
    def _is_map(self) -> bool:
        return self._config.clouds == "map"

    def placement(self, cloud: PointCloud) -> Placement:
        """Return the placement of a cloud. Raises ``ValueError`` for an unusable cloud.

        The stamp of a scan must be at most a second before the newest odometry; stamps of maps are
        ignored.
        """
        newest_ns = self._frames.newest_ns
        if newest_ns is None:
            raise ValueError("a cloud without odometry: its position is unknown")
        late = 1e-9 * (newest_ns - cloud.stamp_ns)
        if late > _MAX_SCAN_AGE and not self._is_map:
            raise ValueError(f"a cloud stamped {late:.3f} s before the newest odometry")
        stamp_ns = newest_ns if self._is_map and abs(late) > _MAX_SCAN_AGE else cloud.stamp_ns
        pose = self._frames.pose(cloud.frame_id, stamp_ns)
        body = self._frames.body_pose(newest_ns if self._is_map else stamp_ns).p
        origin = self.origin if self.has_cloud else local_origin(body)
        return Placement(stamp_ns, pose._replace(p=pose.p - origin), body - origin, origin)

    def placed(self, cloud: PointCloud, placement: Placement) -> Points:
        """Return the transformed points of a cloud, of a scan within range only."""
        points = placement.pose.applied(cloud.p_SQ)
        if not self._is_map:
            points = points[_within(points, placement.body, self._config.range)]
        return points.astype(np.float32, copy=False)

    def insert(self, points: Points, placement: Placement) -> None:
        """Insert transformed points."""
        if self._is_map:
            self._voxels.clear()
        self.origin, stamp_ns = placement.origin, placement.stamp_ns
        self._voxels.insert(points, stamp_ns)
        self._newest_ns = max(stamp_ns, self._newest_ns or stamp_ns)
        self.revision += 1

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform all points by an odometry jump: a map may be published only once."""
        points = reset.points(self._voxels.points + self.origin)
        self.origin = local_origin(reset.points(self.origin))
        self._voxels.move((points - self.origin).astype(np.float32))
        self.revision += 1

    def forget(self, now_ns: int) -> None:
        """Remove expired points."""
        if not self._is_map and self._voxels.forget_before(now_ns - self._forget_ns):
            self.revision += 1

    def age(self, stamp_ns: int) -> float:
        """Return the age of the newest scan [s]; 0 if all have expired, and for a map."""
        age = self.silence(stamp_ns)
        return age if age <= self._config.forget_after else 0.0

    def silence(self, stamp_ns: int) -> float:
        """Return the time since the last scan [s]; 0 for a map, and before the first scan."""
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

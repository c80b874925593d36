# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The known obstacles, from a file, clouds, markers and neighbours."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.config import ObstacleParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.obstacles.clouds import Clouds
from quad_mpc_ros.extras.obstacles.frames import Frames
from quad_mpc_ros.extras.obstacles.markers import Markers
from quad_mpc_ros.extras.obstacles.moving import MovingPoints
from quad_mpc_ros.extras.obstacles.neighbours import Neighbour, Plans
from quad_mpc_ros.extras.obstacles.surfaces import surface_points, wall_points
from quad_mpc_ros.extras.obstacles.voxels import Points
from quad_mpc_ros.messages.obstacle_messages import Marker, TimedPath, Transform
from quad_mpc_ros.messages.point_cloud import PointCloud
from quad_mpc_ros.simulation.shapes import Scene

_SPACING = 0.1  # m between points of a surface
_QUERY_MARGIN = 1.0  # m beyond the requested radius, so that a map can be reused


class _StaticObstacles(NamedTuple):
    """An immutable snapshot of the received static obstacles.

    ``clouds`` (n, 3) [m] are 32-bit and relative to ``origin`` (3,); ``markers`` are arrays of
    points (m, 3) [m].
    """

    revision: int
    clouds: Points
    origin: Array
    markers: list[Array]


class ObstacleWorld:
    """The known obstacles, in the odometry frame; times are stamps of the odometry's clock [ns].

    Every ``receive`` raises ``ValueError`` with one line for an unusable message, without effect.

    Receiving clouds and calling :meth:`points` is permitted in another thread. Writing uses one
    lock; static obstacles are read from one snapshot, which is replaced as a whole.
    """

    def __init__(
        self,
        config: ObstacleParameters,
        scene: Scene | None = None,
        *,
        frame_id: str = "odom",
    ) -> None:
        """Initialise with a scene, of which only static obstacles are used."""
        self._scene = (scene or Scene()).static
        self._resolution = config.resolution
        self._frames = Frames(frame_id)
        self._clouds = Clouds(config, self._frames)
        self._markers = Markers(self._frames, spacing=_SPACING)
        self._neighbours = {name: Neighbour(frame_id) for name in config.neighbours}
        surfaces = [surface_points(shape, _SPACING) for shape in self._scene.shapes]
        self._fixed = np.vstack(surfaces) if surfaces else np.zeros((0, 3))
        self._lock, self._resets = threading.Lock(), 0
        self._static = _StaticObstacles(0, self._clouds.points, self._clouds.origin, [])

    @property
    def neighbours(self) -> Mapping[str, Neighbour]:
        """The neighbours by name."""
        return self._neighbours

    @property
    def spacing(self) -> float:
        """Greatest distance between points of a surface, at opposite ends of two cubes [m]."""
        return max(_SPACING, 2.0 * self._resolution) if self._clouds.has_cloud else _SPACING

    @property
    def revision(self) -> int:
        """A number that changes with the result of :meth:`points`."""
        return self._static.revision

    def receive_odometry(self, odometry: OdometrySample) -> None:
        """Receive the odometry, for transforms and time; remove expired points and markers."""
        with self._changing():
            self._frames.receive_odometry(odometry)
            now_ns = self._frames.newest_ns
            if now_ns is not None:
                self._clouds.forget(now_ns)
                self._markers.forget(now_ns)

    def receive_cloud(self, cloud: PointCloud) -> None:
        """Receive a scan or a map; drop messages transformed before an odometry jump."""
        with self._lock:
            placement, resets = self._clouds.placement(cloud), self._resets
        points = self._clouds.placed(cloud, placement)  # slow, and needs no lock
        with self._changing():
            if resets == self._resets:
                self._clouds.insert(points, placement)

    def receive_markers(self, markers: Sequence[Marker]) -> None:
        """Receive markers; valid markers are used even if others raise an error."""
        with self._changing():
            self._markers.receive(markers)

    def receive_transforms(self, transforms: Sequence[Transform]) -> None:
        """Receive transforms of sensor frames."""
        with self._lock:
            for transform in transforms:
                self._frames.receive_transform(transform)

    def receive_neighbour(self, name: str, message: OdometrySample | TimedPath) -> None:
        """Receive the odometry or the plan of a neighbour."""
        neighbour = self._neighbours[name]
        try:
            if isinstance(message, TimedPath):
                neighbour.receive_plan(message)
            else:
                neighbour.receive_odometry(message)
        except ValueError as error:
            raise ValueError(f"neighbour '{name}': {error}") from None

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform received obstacles; obstacles of the file keep their coordinates."""
        with self._changing():
            self._frames.forget_poses()
            self._clouds.reset_estimate(reset)
            self._markers.reset_estimate(reset)
            self._resets += 1

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Hold the lock, and replace the snapshot if it has changed, also after an exception."""
        with self._lock:
            try:
                yield
            finally:
                revision = self._clouds.revision + self._markers.revision
                if revision != self._static.revision:
                    clouds, markers = self._clouds, self._markers.static_points
                    cloud = clouds.points, clouds.origin
                    self._static = _StaticObstacles(revision, *cloud, markers)

    def points(self, stamp_ns: int, *, near: Array, radius: float) -> Array:
        """Return all static points (n, 3) [m] within a radius of a position, and some beyond."""
        known, wide = self._static, radius + _QUERY_MARGIN
        found = [_within(points, near, wide) for points in (self._fixed, *known.markers)]
        found.insert(1, _within(known.clouds, near - known.origin, wide) + known.origin)
        if self._scene.volume is not None:
            found.append(wall_points(self._scene.volume, _SPACING, near=near, radius=wide))
        return np.vstack(found)

    def moving(self, stamp_ns: int, *, near: Array, radius: float) -> MovingPoints:
        """Return the moving points without neighbours, predicted for a time."""
        now_ns = self._frames.newest_ns or stamp_ns
        parts = []
        for moved in self._markers.moving(stamp_ns):
            shape, old_ns = moved.shape, now_ns - moved.received_ns
            if float(np.linalg.norm(shape.p_WO - near)) - shape.outer_radius <= radius:
                surface = surface_points(shape, _SPACING)
                parts.append(_points_of(surface, shape.v_WO_W, moved.number, old_ns))
        if not parts:
            return MovingPoints.none()
        return MovingPoints(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def plans(self, stamps_ns: Sequence[int]) -> Plans:
        """Return the planned positions of neighbours with a recent message at times [ns]."""
        now_ns = self._frames.newest_ns or stamps_ns[0]
        plans = [each.at(stamps_ns, now_ns=now_ns) for each in self._neighbours.values()]
        known = [each for each in plans if each is not None]
        return Plans(
            np.array([each.p_W for each in known]).reshape(len(known), len(stamps_ns), 3),
            np.array([1e-9 * max(now_ns - each.received_ns, 0) for each in known]),
        )

    def age(self, stamp_ns: int) -> float:
        """Return the age of the newest scan [s]; 0 if all have expired, and for a map."""
        return self._clouds.age(stamp_ns)

    def silence(self, stamp_ns: int) -> float:
        """Return the time since the last scan [s]; 0 before the first."""
        return self._clouds.silence(stamp_ns)


def _points_of(
    p_W: Array, v_W: Array, body: int, age_ns: int
) -> tuple[Array, Array, Array, Array]:
    """Return the columns of :class:`MovingPoints` of one body."""
    count = len(p_W)
    return (
        p_W,
        np.tile(v_W, (count, 1)),
        np.full(count, body, dtype=np.int64),
        np.full(count, 1e-9 * max(age_ns, 0)),
    )


def _within(points: NDArray[np.floating[Any]], centre: Array, radius: float) -> Array:
    """Return the points (n, 3) within a radius of a centre (3,)."""
    x, y, z = points.T
    near = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 <= radius**2
    return np.asarray(points[near], dtype=np.float64)

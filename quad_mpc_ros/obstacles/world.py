"""What is known of obstacles by now, from a file, clouds, markers and neighbours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.config import ObstacleParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages.obstacle_messages import Marker, TimedPath, Transform
from quad_mpc_ros.messages.point_cloud import PointCloud
from quad_mpc_ros.obstacles.avoidance import MovingPoints
from quad_mpc_ros.obstacles.clouds import Clouds
from quad_mpc_ros.obstacles.frames import Frames
from quad_mpc_ros.obstacles.markers import Markers
from quad_mpc_ros.obstacles.neighbours import Neighbour
from quad_mpc_ros.obstacles.scene import Scene
from quad_mpc_ros.obstacles.shapes import Shape
from quad_mpc_ros.obstacles.sharing import Plans

_SPACING = 0.1  # m between points of a surface
_BESIDE = 1.0  # m beyond what was asked for, so that the answer serves the next ticks too


class _Answer(NamedTuple):
    """The points within a radius of a place, of a revision."""

    points: Array
    near: Array
    radius: float
    revision: int

    def serves(self, near: Array, radius: float, revision: int) -> bool:
        """Whether it holds all that is asked for."""
        away = float(np.linalg.norm(near - self.near))
        return revision == self.revision and away + radius <= self.radius


class World:
    """What is known of obstacles, as :class:`.avoidance.Obstacles` says.

    Every ``receive`` raises ``ValueError`` with one line for what is of no use, and is then as if
    it had not been called. Clouds may come in another thread than the rest.
    """

    def __init__(
        self,
        config: ObstacleParameters,
        scene: Scene | None = None,
        *,
        frame_id: str = "odom",
        radius: float = 0.0,
    ) -> None:
        """Begin with what stands in a scene; ``radius`` [m] is that of a neighbour."""
        self._scene = (scene or Scene()).standing
        self._radius, self._resolution = radius, config.resolution
        self._frames = Frames(frame_id)
        self._clouds = Clouds(config, self._frames)
        self._markers = Markers(self._frames, spacing=_SPACING)
        self._neighbours = {name: Neighbour(frame_id) for name in config.neighbours}
        surfaces = [shape.surface_points(_SPACING) for shape in self._scene.shapes]
        self._fixed = np.vstack(surfaces) if surfaces else np.zeros((0, 3))
        self._answer: _Answer | None = None
        self._resets = 0

    @property
    def scene(self) -> Scene:
        """What stands by the file, and the volume of flight."""
        return self._scene

    @property
    def neighbours(self) -> Mapping[str, Neighbour]:
        """The neighbours by name."""
        return self._neighbours

    @property
    def spacing(self) -> float:
        """How far points of a surface are apart at most [m].

        Of cubes side by side the points that were kept may be at opposite ends.
        """
        return max(_SPACING, 2.0 * self._resolution) if self._clouds.is_heard else _SPACING

    @property
    def revision(self) -> int:
        """A number that changes when what :meth:`points` returns may have changed."""
        return self._clouds.revision + self._markers.revision + self._resets

    def receive_odometry(self, odometry: OdometrySample) -> None:
        """Take where the vehicle is, by which clouds in its frame are placed, and the time.

        What has been seen for too long, or has outlived its lifetime, is forgotten.
        """
        self._frames.receive_odometry(odometry)
        now_ns = self._frames.newest_ns
        if now_ns is not None:
            self._clouds.forget(now_ns)
            self._markers.forget(now_ns)

    def receive_cloud(self, cloud: PointCloud) -> None:
        """Take a scan or a map."""
        self._clouds.receive(cloud)

    def receive_markers(self, markers: Sequence[Marker]) -> None:
        """Take markers; those of use are taken even if it raises for others."""
        self._markers.receive(markers)

    def receive_transforms(self, transforms: Sequence[Transform]) -> None:
        """Take transforms of the frames of sensors."""
        for transform in transforms:
            self._frames.receive_transform(transform)

    def receive_neighbour(self, name: str, heard: OdometrySample | TimedPath) -> None:
        """Take the odometry or the plan of a neighbour."""
        neighbour = self._neighbours[name]
        try:
            if isinstance(heard, TimedPath):
                neighbour.receive_plan(heard)
            else:
                neighbour.receive_odometry(heard)
        except ValueError as error:
            raise ValueError(f"neighbour '{name}': {error}") from None

    def reset_estimate(self) -> None:
        """Forget what was seen: the frame of the odometry has moved."""
        self._frames.forget_poses()
        self._clouds.clear()
        self._markers.clear()
        self._resets += 1

    def points(self, stamp_ns: int, *, near: Array, radius: float) -> Array:
        """Return points (n, 3) [m] of what stands, all within a radius of a place and some more.

        The same array as long as it serves.
        """
        parts: list[NDArray[np.floating[Any]]] = [self._fixed, self._clouds.points]
        parts += self._markers.standing_points
        revision = self.revision
        answer = self._answer
        if answer is None or not answer.serves(near, radius, revision):
            wide = radius + _BESIDE
            found = [_within(points, near, wide) for points in parts]
            if self._scene.volume is not None:
                found.append(self._scene.volume.wall_points(_SPACING, near=near, radius=wide))
            answer = _Answer(np.vstack(found), near.copy(), wide, revision)
            self._answer = answer
        return answer.points

    def moving(self, stamp_ns: int, *, near: Array, radius: float) -> MovingPoints:
        """Return what moves, neighbours apart, where it is predicted to be at a time."""
        now_ns = self._frames.newest_ns or stamp_ns
        parts = []
        for moved in self._markers.moving(stamp_ns):
            shape, old_ns = moved.shape, now_ns - moved.told_ns
            if float(np.linalg.norm(shape.p_WO - near)) - shape.outer_radius <= radius:
                surface = shape.surface_points(_SPACING)
                parts.append(_points_of(surface, shape.v_WO_W, moved.number, old_ns))
        if not parts:
            return MovingPoints.none()
        return MovingPoints(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def plans(self, stamps_ns: Sequence[int]) -> Plans:
        """Return where the neighbours of whom something was heard plan to be at times [ns]."""
        now_ns = self._frames.newest_ns or stamps_ns[0]
        heard = [each.at(stamps_ns, now_ns=now_ns) for each in self._neighbours.values()]
        known = [each for each in heard if each is not None]
        return Plans(
            np.array([each.p_W for each in known]).reshape(len(known), len(stamps_ns), 3),
            np.array([1e-9 * max(now_ns - each.told_ns, 0) for each in known]),
        )

    def age(self, stamp_ns: int) -> float:
        """Return how old the newest of what is known of things that stand is [s]; 0 for a map."""
        return self._clouds.age(stamp_ns)

    def silence(self, stamp_ns: int) -> float:
        """Return how long no scan has come [s]; 0 before the first."""
        return self._clouds.silence(stamp_ns)

    def distance(self, stamp_ns: int, p_WQ: Array) -> Array:
        """Return the signed distances (n,) [m] of points (n, 3) [m] to all that is known.

        To points of clouds and lists they are not negative.
        """
        shapes: list[Shape] = [*self._scene.shapes, *self._markers.shapes(stamp_ns)]
        nearest = Scene(shapes).distance(p_WQ, 0.0)
        if self._scene.volume is not None:
            nearest = np.minimum(nearest, self._scene.volume.distance(p_WQ))
        points: NDArray[np.floating[Any]] = self._clouds.points
        points = np.vstack([points, *self._markers.standing_points])
        if len(points):
            from scipy.spatial import cKDTree

            nearest = np.minimum(nearest, cKDTree(points).query(p_WQ)[0])
        now_ns = self._frames.newest_ns or stamp_ns
        for neighbour in self._neighbours.values():
            heard = neighbour.at([stamp_ns], now_ns=now_ns)
            if heard is not None:
                away = np.linalg.norm(p_WQ - heard.p_W, axis=1) - self._radius
                nearest = np.minimum(nearest, away)
        return nearest


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
    """Return those of points (n, 3) that lie within a radius of a centre (3,)."""
    x, y, z = points.T
    near = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 <= radius**2
    return np.asarray(points[near], dtype=np.float64)

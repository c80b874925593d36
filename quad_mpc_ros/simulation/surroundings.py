"""What a simulated vehicle flies among: what a sensor sees of it, and where it flies into it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages.obstacle_messages import Marker
from quad_mpc_ros.messages.point_cloud import PointCloud
from quad_mpc_ros.obstacles.files import read_scene
from quad_mpc_ros.obstacles.markers import shape_marker
from quad_mpc_ros.obstacles.scene import Scene
from quad_mpc_ros.obstacles.shapes import Shape

_ROUND, _UP_AND_DOWN = 240, 31  # rays: a pillar of 0.2 m is met at 6 m
_HIGHEST = math.radians(45.0)
_BETWEEN = 5  # places looked at between two odometries


@dataclass(frozen=True, kw_only=True)
class ObstacleSensorParameters(Configuration):
    """Obstacles, and what is told of them."""

    owner = "simulator.obstacles"

    file: str = parameter(
        "", doc="File of boxes, cylinders and spheres; a vehicle that touches one has crashed."
    )
    sensor: str = parameter(
        "none",
        doc="What is seen of them: nothing, points where rays all around the vehicle end (on "
        "obstacles), or the shapes themselves (on obstacle_markers).",
        choices=("none", "rays", "markers"),
    )
    sensor_range: float = parameter(
        6.0, doc="How far the sensor sees.", unit="m", above=0.0, maximum=1000.0
    )
    sensor_rate: float = parameter(10.0, doc="How often it does.", unit="Hz", above=0.0)


class Collision(NamedTuple):
    """When [s], where (3,) [m] and how fast [m/s] a vehicle flew into something."""

    time: float
    p_WB: Array
    speed: float

    @property
    def text(self) -> str:
        """The collision in words."""
        x, y, z = self.p_WB.tolist()
        return (
            f"it flew into an obstacle at {self.time:.2f} s, at ({x:.2f}, {y:.2f}, {z:.2f}) m "
            f"with {self.speed:.2f} m/s"
        )


class Seen(NamedTuple):
    """What a sensor tells at a time: a cloud, markers, or neither."""

    cloud: PointCloud | None = None
    markers: tuple[Marker, ...] = ()


def scene_of(config: ObstacleSensorParameters) -> Scene | None:
    """Return what the file of the parameters states, None without one.

    Raises :class:`UserError` for a file of no use.
    """
    return read_scene(Path(config.file).expanduser()) if config.file else None


NOTHING_SEEN = Seen()


class Surroundings:
    """A scene around a vehicle; times from the start of the flight."""

    def __init__(
        self, config: ObstacleSensorParameters, *, radius: float, scene: Scene | None = None
    ) -> None:
        """Take what is there: the scene, or else the file of the parameters.

        ``radius`` [m] is the vehicle's. Raises :class:`UserError` for a file of no use.
        """
        self.scene = scene or scene_of(config) or Scene()
        self._config, self._radius = config, radius
        self._period_ns = round(1e9 / config.sensor_rate)
        self._due_ns = 0
        self._shown: set[int] = set()
        self._before: tuple[float, Array] | None = None

    def look(self, truth: OdometrySample, time_ns: int) -> Seen:
        """Return what is told with an odometry: of what is there, if the sensor is due."""
        if self._config.sensor == "none" or not self.scene.shapes or time_ns < self._due_ns:
            return NOTHING_SEEN
        self._due_ns += self._period_ns * max(1, -(-(time_ns - self._due_ns) // self._period_ns))
        seconds, reach = 1e-9 * time_ns, self._config.sensor_range
        if self._config.sensor == "markers":
            return Seen(markers=self._marked(truth, seconds, reach))
        return Seen(cloud=scan(self.scene, truth, seconds=seconds, reach=reach))

    def collision(self, truth: OdometrySample, time_ns: int) -> Collision | None:
        """Return the collision since the last odometry, if any."""
        seconds, place = 1e-9 * time_ns, truth.p_WB
        before, now = self._before or (seconds, place), (seconds, place)
        self._before = now
        for share in np.linspace(1.0 / _BETWEEN, 1.0, _BETWEEN):
            time = before[0] + share * (now[0] - before[0])
            p_WB = before[1] + share * (now[1] - before[1])
            if self.scene.clearance(p_WB, time) < self._radius:
                return Collision(time, p_WB, truth.speed)
        return None

    def _marked(self, truth: OdometrySample, seconds: float, reach: float) -> tuple[Marker, ...]:
        """Return the shapes in reach as markers, and that others are there no more."""
        gaps = [
            (number, shape.after(seconds))
            for number, shape in enumerate(self.scene.shapes)
            if seconds >= shape.appears_at
        ]
        near = {
            number: shape
            for number, shape in gaps
            if float(shape.distance(truth.p_WB[None])[0]) <= reach
        }
        gone = [_marker(truth, number, None) for number in sorted(self._shown - near.keys())]
        self._shown = set(near)
        return (*gone, *(_marker(truth, number, shape) for number, shape in near.items()))


def scan(
    scene: Scene, truth: OdometrySample, *, seconds: float, reach: float
) -> PointCloud | None:
    """Return the points, in the body, where rays all around meet a scene; None if none does.

    The rays are 1.5 degrees apart across and 3 up and down, to 45 degrees; ``reach`` [m] long.
    """
    R_WB = so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw)
    lengths = np.full(len(_RAYS), np.inf)
    rays_W = np.einsum("ij,nj->ni", R_WB, _RAYS)
    for shape in scene.near(truth.p_WB, reach, seconds):
        towards = _towards(shape, truth.p_WB, rays_W)
        met = shape.ray_lengths(truth.p_WB, rays_W[towards])
        lengths[towards] = np.minimum(lengths[towards], met)
    ends = lengths <= reach
    if not ends.any():
        return None
    points = (_RAYS[ends] * lengths[ends, None]).astype(np.float32)
    return PointCloud(
        stamp_ns=truth.stamp_ns, frame_id=truth.child_frame_id, p_SQ=points, given=len(_RAYS)
    )


def _towards(shape: Shape, p_WC: Array, rays_W: Array) -> NDArray[np.intp]:
    """Return which rays may meet the sphere about a shape."""
    to_it = shape.p_WO - p_WC
    along = rays_W @ to_it
    away = float(to_it @ to_it) - along * along
    return np.flatnonzero((away <= shape.outer_radius**2) & (along > -shape.outer_radius))


def _marker(truth: OdometrySample, number: int, shape: Shape | None) -> Marker:
    """Return a shape as a marker in the frame of the odometry, or that it is there no more."""
    stamp_ns, frame_id = truth.stamp_ns, truth.frame_id
    return shape_marker(shape, number, stamp_ns=stamp_ns, frame_id=frame_id)


def _rays() -> Array:
    """Return unit vectors (n, 3) all around, level and up to 45 degrees up and down."""
    azimuth = np.linspace(-math.pi, math.pi, _ROUND, endpoint=False)
    elevation = np.linspace(-_HIGHEST, _HIGHEST, _UP_AND_DOWN)
    around, up = (each.ravel() for each in np.meshgrid(azimuth, elevation))
    flat = np.cos(up)
    return np.column_stack((flat * np.cos(around), flat * np.sin(around), np.sin(up)))


_RAYS = _rays()

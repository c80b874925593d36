# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulated obstacle sensor and collisions with a scene.

Rays are intersected with shapes exactly, with the slab method (Kay and Kajiya, SIGGRAPH 1986).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.obstacles.markers import shape_marker
from quad_mpc_ros.messages.obstacle_messages import Marker
from quad_mpc_ros.messages.point_cloud import PointCloud
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Scene, Shape, Sphere
from quad_mpc_ros.simulation.surroundings import (
    NOTHING_SENSED,
    Collision,
    ObstacleSensorParameters,
    SensedObstacles,
)

_AZIMUTH_COUNT, _ELEVATION_COUNT = 240, 31  # rays: a pillar of 0.2 m is hit at 6 m
_MAX_ELEVATION = math.radians(45.0)
_COLLISION_CHECKS = 5  # between two odometries
_TINY = 1e-12


class SimulatedSurroundings:
    """A scene around a simulated vehicle; times are from the start of the flight."""

    def __init__(self, config: ObstacleSensorParameters, scene: Scene, *, radius: float) -> None:
        """Initialise with the sensor, the scene and the radius of the vehicle [m]."""
        self.scene = scene
        self._config, self._radius = config, radius
        self._period_ns = round(1e9 / config.sensor_rate)
        self._due_ns = 0
        self._shown: set[int] = set()
        self._before: tuple[float, Array] | None = None

    def check_start(self, p_WB: Array) -> None:
        """Raise :class:`UserError` for a vehicle in contact at ``p_WB`` (3,)."""
        away = [float(shape.distance(p_WB[None])[0]) for shape in self.scene.there(0.0)]
        if min(away, default=math.inf) < self._radius:
            shape = self.scene.there(0.0)[int(np.argmin(away))]
            kind, place = type(shape).__name__.lower(), np.round(shape.p_WO, 3).tolist()
            raise UserError(
                f"simulator.initial_position: given {np.round(p_WB, 3).tolist()}, "
                f"{min(away):.2f} m from the surface of the {kind} at {place}, expected at least "
                f"the vehicle's radius, {self._radius:g} m; move the start or the obstacle"
            )

    def look(self, truth: OdometrySample, time_ns: int) -> SensedObstacles:
        """Return the sensor message of an odometry, if the sensor is due."""
        if self._config.sensor == "none" or not self.scene.shapes or time_ns < self._due_ns:
            return NOTHING_SENSED
        self._due_ns += self._period_ns * max(1, -(-(time_ns - self._due_ns) // self._period_ns))
        seconds, reach = 1e-9 * time_ns, self._config.sensor_range
        if self._config.sensor == "markers":
            return SensedObstacles(markers=self._marked(truth, seconds, reach))
        return SensedObstacles(cloud=scan(self.scene, truth, seconds=seconds, reach=reach))

    def collision(self, truth: OdometrySample, time_ns: int) -> Collision | None:
        """Return the collision since the last odometry, if any."""
        seconds, place = 1e-9 * time_ns, truth.p_WB
        before, now = self._before or (seconds, place), (seconds, place)
        self._before = now
        for share in np.linspace(1.0 / _COLLISION_CHECKS, 1.0, _COLLISION_CHECKS):
            time = before[0] + share * (now[0] - before[0])
            p_WB = before[1] + share * (now[1] - before[1])
            near = self.scene.near(p_WB, self._radius, time)
            if any(shape.distance(p_WB[None])[0] < self._radius for shape in near):
                return Collision(time, p_WB, truth.speed)
        return None

    def _marked(self, truth: OdometrySample, seconds: float, reach: float) -> tuple[Marker, ...]:
        """Return the markers of the shapes in range, and deletions of others."""
        near: dict[int, Shape | None] = {}
        for number, shape in enumerate(self.scene.shapes):
            there = shape.after(seconds)
            appeared = seconds >= shape.appears_at
            if appeared and float(there.distance(truth.p_WB[None])[0]) <= reach:
                near[number] = there
        gone = dict.fromkeys(sorted(self._shown - near.keys()))
        self._shown = set(near)
        return tuple(
            shape_marker(shape, number, stamp_ns=truth.stamp_ns, frame_id=truth.frame_id)
            for number, shape in (gone | near).items()
        )


def scan(
    scene: Scene, truth: OdometrySample, *, seconds: float, reach: float
) -> PointCloud | None:
    """Return the points in the body frame where rays hit a scene; None without any hit.

    The rays cover all azimuths every 1.5 degrees and elevations to 45 degrees every 3 degrees.
    """
    R_WB = so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw)
    lengths = np.full(len(_RAYS), np.inf)
    rays_W = np.einsum("ij,nj->ni", R_WB, _RAYS)
    for shape in scene.near(truth.p_WB, reach, seconds):
        towards = _towards(shape, truth.p_WB, rays_W)
        met = ray_lengths(shape, truth.p_WB, rays_W[towards])
        lengths[towards] = np.minimum(lengths[towards], met)
    ends = lengths <= reach
    if not ends.any():
        return None
    points = (_RAYS[ends] * lengths[ends, None]).astype(np.float32)
    return PointCloud(stamp_ns=truth.stamp_ns, frame_id=truth.child_frame_id, p_SQ=points)


def _towards(shape: Shape, p_WC: Array, rays_W: Array) -> NDArray[np.intp]:
    """Return which rays may hit the bounding sphere of a shape."""
    to_it = shape.p_WO - p_WC
    along = rays_W @ to_it
    away = float(to_it @ to_it) - along * along
    return np.flatnonzero((away <= shape.outer_radius**2) & (along > -shape.outer_radius))


def ray_lengths(shape: Shape, p_WC: Array, directions_W: Array) -> Array:
    """Return the lengths (n,) [m] of rays (n, 3), unit vectors, from a point (3,) [m] to a shape.

    Infinite for rays that miss the shape; 0 from inside.
    """
    p_OC = shape.turned((p_WC - shape.p_WO)[None])[0]
    directions_O = shape.turned(directions_W)
    if isinstance(shape, Box):
        enters, leaves = _slabs(p_OC, directions_O, shape.half_extents)
        return _first_meeting(enters.max(axis=1), leaves.min(axis=1))
    if isinstance(shape, Cylinder):
        return _to_cylinder(shape, p_OC, directions_O)
    assert isinstance(shape, Sphere)
    return _first_meeting(*_through_round(p_OC, directions_O, shape.radius))


def _to_cylinder(cylinder: Cylinder, p_OC: Array, directions_O: Array) -> Array:
    across, at = directions_O[:, :2], p_OC[:2]
    enters, leaves = _through_round(at, across, cylinder.radius)
    from_end, to_end = _slabs(p_OC[2:], directions_O[:, 2:], np.array([0.5 * cylinder.height]))
    return _first_meeting(np.maximum(enters, from_end[:, 0]), np.minimum(leaves, to_end[:, 0]))


def _slabs(p: Array, directions: Array, half: Array) -> tuple[Array, Array]:
    """Return the lengths at which rays enter and leave the slab |x| < half of each axis (n, k)."""
    steep = np.where(np.abs(directions) < _TINY, np.copysign(_TINY, directions), directions)
    first, second = (-half - p) / steep, (half - p) / steep
    return np.minimum(first, second), np.maximum(first, second)


def _through_round(p: Array, directions: Array, radius: float) -> tuple[Array, Array]:
    """Return the lengths at which rays enter and leave a circle or sphere around 0."""
    a = np.maximum(np.einsum("ni,ni->n", directions, directions), _TINY**2)
    b = directions @ p
    c = float(p @ p) - radius * radius
    square = b * b - a * c
    root = np.sqrt(np.maximum(square, 0.0))
    meets = square >= 0.0
    enters = np.where(meets, (-b - root) / a, np.inf)
    leaves = np.where(meets, (-b + root) / a, -np.inf)
    return enters, leaves


def _first_meeting(enters: Array, leaves: Array) -> Array:
    meets = (enters <= leaves) & (leaves >= 0.0)
    return np.where(meets, np.maximum(enters, 0.0), np.inf)


def _rays() -> Array:
    """Return the unit vectors (n, 3) of the rays."""
    azimuth = np.linspace(-math.pi, math.pi, _AZIMUTH_COUNT, endpoint=False)
    elevation = np.linspace(-_MAX_ELEVATION, _MAX_ELEVATION, _ELEVATION_COUNT)
    around, up = (each.ravel() for each in np.meshgrid(azimuth, elevation))
    flat = np.cos(up)
    return np.column_stack((flat * np.cos(around), flat * np.sin(around), np.sin(up)))


_RAYS = _rays()

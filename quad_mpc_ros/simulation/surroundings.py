# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulator's interface to obstacles, which are an optional part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from quad_mpc_ros.configuration import Configuration, files, optional_part, parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages.obstacle_messages import Marker
from quad_mpc_ros.messages.point_cloud import PointCloud
from quad_mpc_ros.simulation.shapes import Scene

_FILE_PARAMETER = "simulator.obstacles.file"


@dataclass(frozen=True, kw_only=True)
class ObstacleSensorParameters(Configuration):
    """Obstacles and the sensor that detects them."""

    owner = "simulator.obstacles"

    file: str = parameter(
        "", doc="File of boxes, cylinders and spheres; a vehicle that touches one crashes."
    )
    sensor: str = parameter(
        "none",
        doc="Sensor of the obstacles: none, rays (a point cloud on obstacles), or markers (the "
        "shapes on obstacle_markers).",
        choices=("none", "rays", "markers"),
    )
    sensor_range: float = parameter(
        6.0, doc="Range of the sensor.", unit="m", above=0.0, maximum=1000.0
    )
    sensor_rate: float = parameter(10.0, doc="Rate of the sensor.", unit="Hz", above=0.0)


class Collision(NamedTuple):
    """Time [s], position (3,) [m] and speed [m/s] of a collision."""

    time: float
    p_WB: Array
    speed: float

    @property
    def text(self) -> str:
        """The collision as text."""
        x, y, z = self.p_WB.tolist()
        return (
            f"collision with an obstacle at {self.time:.2f} s, at ({x:.2f}, {y:.2f}, {z:.2f}) m "
            f"with {self.speed:.2f} m/s"
        )


class SensedObstacles(NamedTuple):
    """The message of a sensor at a time: a cloud, markers, or neither."""

    cloud: PointCloud | None = None
    markers: tuple[Marker, ...] = ()


NOTHING_SENSED = SensedObstacles()


class ObstacleReceiver(Protocol):
    """Receiver of sensed obstacles, for the guide of a controller.

    Each method raises ``ValueError`` for unusable input.
    """

    def receive_odometry(self, odometry: OdometrySample) -> None:
        """Take an odometry."""

    def receive_cloud(self, cloud: PointCloud) -> None:
        """Take a point cloud."""

    def receive_markers(self, markers: Sequence[Marker]) -> None:
        """Take shapes."""


class ObstacleSimulation(Protocol):
    """Simulated obstacles around a vehicle; times are from the start of the flight."""

    def check_start(self, p_WB: Array) -> None:
        """Raise :class:`UserError` for a vehicle that would start in contact at ``p_WB`` (3,)."""

    def look(self, truth: OdometrySample, time_ns: int) -> SensedObstacles:
        """Return the sensor message of an odometry, if the sensor is due."""

    def collision(self, truth: OdometrySample, time_ns: int) -> Collision | None:
        """Return the collision since the last odometry, if any."""


def configured_scene(config: ObstacleSensorParameters) -> Scene | None:
    """Return the scene of the configured file, None without a file.

    Raises :class:`UserError` for an unusable file.
    """
    if not config.file:
        return None
    scene: Scene = optional_part("read_scene", needed_by=_FILE_PARAMETER)(
        files.expanded(config.file)
    )
    return scene


def configured_surroundings(
    config: ObstacleSensorParameters, *, radius: float, scene: Scene | None = None
) -> ObstacleSimulation | None:
    """Return the simulation of a scene, or of the configured file; None without obstacles.

    ``radius`` [m] is the vehicle's radius. Raises :class:`UserError` for an unusable file.
    """
    found = scene or configured_scene(config)
    if found is None:
        return None
    make = optional_part("simulated_surroundings", needed_by=_FILE_PARAMETER)
    surroundings: ObstacleSimulation = make(config, found, radius=radius)
    return surroundings

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Configured waypoints, held in turn or flown through; and a hover."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.configuration.box import FARTHEST
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import LegParameters, minimum_snap_path
from quad_mpc_ros.references.path import Chain, Path, RestPath
from quad_mpc_ros.references.trajectory import (
    TrajectoryParameters,
    TrajectorySamples,
    at_rest,
)

_SAME_PLACE = 1e-6  # m


@dataclass(frozen=True, kw_only=True)
class StopParameters(LegParameters):
    """Common parameters of trajectories that hold points in turn."""

    dwell_time: float = parameter(
        2.0,
        doc="square, waypoints: time at each corner or waypoint.",
        unit="s",
        above=0.0,
    )
    preview: bool = parameter(
        False,
        doc="square: true includes the next corners in windows; false holds the current corner "
        "over the window. Windows of smooth trajectories always contain the trajectory ahead.",
    )


@dataclass(frozen=True, kw_only=True)
class WaypointParameters(StopParameters):
    """The configured points."""

    waypoints: tuple[float, ...] = parameter(
        (0.0, 0.0, 2.0, 2.0, 0.0, 2.0, 2.0, 2.0, 2.0, 0.0, 2.0, 2.0, 0.0, 0.0, 2.0),
        doc="waypoints, minimum_snap: x, y, z of each point in turn, relative to the origin.",
        unit="m",
        minimum=-FARTHEST,
        maximum=FARTHEST,
    )


def configured_waypoints(config: WaypointParameters) -> Array:
    """Return the waypoints (n, 3) [m] in the world.

    Raises :class:`ConfigurationError` for fewer than two or equal successive waypoints.
    """
    name, given = f"{config.owner}.waypoints", config.waypoints
    if len(given) % 3:
        raise ConfigurationError(name, given, f"x, y, z of each point, not {len(given)} numbers")
    if len(given) < 6:
        raise ConfigurationError(name, given, f"at least 2 points, not {len(given) // 3}")
    points = np.reshape(given, (-1, 3))
    for index, step in enumerate(np.linalg.norm(np.diff(points, axis=0), axis=1), start=1):
        if not step > _SAME_PLACE:
            raise ConfigurationError(
                name,
                given,
                f"points apart from each other: waypoint {index} (counted from 0) is at the "
                f"position of waypoint {index - 1}",
            )
    return np.asarray(points + np.array([*config.origin, 0.0]))


def through_waypoints(config: WaypointParameters) -> Path:
    """Return the path of minimum snap through the waypoints."""
    return minimum_snap_path(
        configured_waypoints(config),
        max_speed=config.max_speed,
        max_acceleration=config.max_acceleration,
    )


def waypoints(config: WaypointParameters) -> Path:
    """Return the minimum-snap path between successive waypoints, with a rest at each."""
    points = configured_waypoints(config)
    return Chain(
        [*rests_and_legs(points, config), RestPath(points[-1], duration=config.dwell_time)]
    )


def rests_and_legs(points: Array, config: StopParameters) -> list[Path]:
    """Return a rest at each point (n, 3) [m] except the last, and the leg to the next point."""
    links: list[Path] = []
    for start, end in itertools.pairwise(points):
        links.append(RestPath(start, duration=config.dwell_time))
        links.append(
            minimum_snap_path(
                np.stack((start, end)),
                max_speed=config.max_speed,
                max_acceleration=config.max_acceleration,
            )
        )
    return links


class Steps:
    """Points (n, 3) [m], each held for ``dwell_time`` [s], repeated; a single point is a hover.

    Jumps between points are infeasible for any vehicle: they test the controller.
    """

    fixed = True

    def __init__(self, points: Array, *, yaw: float, dwell_time: float = 1.0) -> None:
        self._points = points
        self._dwell_ns = round(dwell_time * 1e9)
        self._yaw = yaw
        self.smooth = len(points) == 1
        self.period_ns = 0 if self.smooth else len(points) * self._dwell_ns

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the points held at these times; before the start, the first point."""
        places = [max(time // self._dwell_ns, 0) % len(self._points) for time in times_ns]
        return at_rest(self._points[places], yaw=self._yaw)

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the switches between points in (start, end]."""
        if self.smooth:
            return []
        first, last = max(start_ns // self._dwell_ns + 1, 1), end_ns // self._dwell_ns
        return [leg * self._dwell_ns for leg in range(first, last + 1)]


def hover(config: TrajectoryParameters) -> Steps:
    """Return one point above the origin, held at a heading."""
    return Steps(np.array([[*config.origin, config.height]]), yaw=config.yaw)

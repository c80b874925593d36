"""Configured waypoints: held one after the other, or flown through."""

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
    """Common parameters of trajectories that hold points one after the other."""

    dwell_time: float = parameter(
        2.0,
        doc="square, waypoints: time at each corner or waypoint before the next one.",
        unit="s",
        above=0.0,
    )
    preview: bool = parameter(
        False,
        doc="square, waypoints with legs of jump: show what is ahead; otherwise the present "
        "corner is held over the window. Smooth trajectories always show what is ahead.",
    )


@dataclass(frozen=True, kw_only=True)
class WaypointParameters(StopParameters):
    """Where to go, and how."""

    waypoints: tuple[float, ...] = parameter(
        (0.0, 0.0, 2.0, 2.0, 0.0, 2.0, 2.0, 2.0, 2.0, 0.0, 2.0, 2.0, 0.0, 0.0, 2.0),
        doc="waypoints, minimum_snap: x, y, z of one point after the other, from the origin.",
        unit="m",
        minimum=-FARTHEST,
        maximum=FARTHEST,
    )
    waypoint_legs: str = parameter(
        "minimum_snap",
        doc="waypoints: how to get from one to the next, by a smooth leg or, as the paper's "
        "square does, by a jump.",
        choices=("minimum_snap", "jump"),
    )


def configured_waypoints(config: WaypointParameters) -> Array:
    """Return the waypoints (n, 3) [m] in the world.

    Raises :class:`ConfigurationError` for fewer than two, and for successive equal ones.
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
                f"place of waypoint {index - 1}",
            )
    return np.asarray(points + np.array([*config.origin, 0.0]))


def waypoints(config: WaypointParameters) -> Path | Steps:
    """Return the way from each waypoint to the next, by jumps or by legs."""
    if config.waypoint_legs == "minimum_snap":
        return from_waypoint_to_waypoint(config)
    points = configured_waypoints(config)
    return Steps(points, dwell_time=config.dwell_time, yaw=config.yaw, closed=False)


def through_waypoints(config: WaypointParameters) -> Path:
    """Return the path of minimum snap through the waypoints."""
    return minimum_snap_path(
        configured_waypoints(config),
        max_speed=config.max_speed,
        max_acceleration=config.max_acceleration,
    )


def from_waypoint_to_waypoint(config: WaypointParameters) -> Path:
    """Return the path of minimum snap from each waypoint to the next, resting at each."""
    points = configured_waypoints(config)
    return Chain(
        [*rests_and_legs(points, config), RestPath(points[-1], duration=config.dwell_time)]
    )


def rests_and_legs(points: Array, config: StopParameters) -> list[Path]:
    """Return a rest at each point (n, 3) [m] but the last, and the leg from there to the next."""
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


class Hover:
    """One point above the origin, held at a heading."""

    smooth = True
    fixed = True
    period_ns = 0

    def __init__(self, config: TrajectoryParameters) -> None:
        self._p_WB = np.array([*config.origin, config.height])
        self._yaw = config.yaw

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the point, once for each time."""
        return at_rest(np.tile(self._p_WB, (len(times_ns), 1)), yaw=self._yaw)

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return none: it never moves."""
        return []


class Steps:
    """Jumps from one point (n, 3) [m] to the next, each held for a while.

    With ``closed`` it repeats, otherwise it stays at the last one. It is not feasible: a test of
    the controller.
    """

    smooth = False
    fixed = True

    def __init__(self, points: Array, *, dwell_time: float, yaw: float, closed: bool) -> None:
        self._points = points
        self._dwell_ns = round(dwell_time * 1e9)
        self._yaw = yaw
        self._closed = closed
        self.period_ns = len(points) * self._dwell_ns

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the points held at these times; the first one before the start."""
        count = len(self._points)
        legs = [max(time // self._dwell_ns, 0) for time in times_ns]
        places = [leg % count if self._closed else min(leg, count - 1) for leg in legs]
        return at_rest(self._points[places], yaw=self._yaw)

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the switches between points in (start, end]."""
        first = max(start_ns // self._dwell_ns + 1, 1)
        last = end_ns // self._dwell_ns
        if not self._closed:
            last = min(last, len(self._points) - 1)
        return [leg * self._dwell_ns for leg in range(first, last + 1)]

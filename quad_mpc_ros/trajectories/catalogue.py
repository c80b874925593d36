"""Every trajectory by its name, and from a configuration to the one it asks for."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path as FilePath

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.trajectories.circle import Circle
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.feasibility import Limits, Verdict, judged
from quad_mpc_ros.trajectories.flat_trajectory import FlatTrajectory
from quad_mpc_ros.trajectories.flip import flip
from quad_mpc_ros.trajectories.hover import Hover
from quad_mpc_ros.trajectories.lemniscate import Lemniscate
from quad_mpc_ros.trajectories.path import Path, Slowed
from quad_mpc_ros.trajectories.point_table import PointTable, read_csv, table_path
from quad_mpc_ros.trajectories.split_s import split_s
from quad_mpc_ros.trajectories.square import smooth_square, square
from quad_mpc_ros.trajectories.trajectory import Trajectory
from quad_mpc_ros.trajectories.vertical_loop import VerticalLoop
from quad_mpc_ros.trajectories.waypoints import (
    Steps,
    configured_waypoints,
    from_waypoint_to_waypoint,
    through_waypoints,
)

BagReader = Callable[[FilePath], PointTable]
"""Returns the odometry of a recorded run. Bags are read above this layer, so it is handed in."""

PATHS: dict[str, Callable[[ReferenceConfig], Path]] = {
    "waypoints": from_waypoint_to_waypoint,
    "circle": Circle,
    "lemniscate": Lemniscate,
    "minimum_snap": through_waypoints,
    "vertical_loop": VerticalLoop,
    "flip": flip,
    "split_s": split_s,
}
"""What is flown by differential flatness."""

# Slowed down they would no longer be what they are: gravity does not slow down with them.
_NOT_SCALABLE = ("vertical_loop", "flip", "split_s")
_LARGEST_FACTOR = 50.0
_GROWTH = 1.2
_PRECISION = 1.005


def configured_trajectory(
    config: ReferenceConfig, *, read_bag: BagReader | None = None
) -> Trajectory:
    """Return the trajectory that a configuration asks for, slowed down if it says so.

    Raises :class:`UserError` for input that gives no trajectory, and for a smooth one that the
    vehicle cannot fly, with where and by how much. One that jumps is feasible for no vehicle and
    not refused: it is there to test controllers.
    """
    return _approved(*judged_trajectory(config, read_bag=read_bag), config)


def joined_trajectory(config: ReferenceConfig, *, read_bag: BagReader | None = None) -> Trajectory:
    """Return the same trajectory with legs of minimum snap in place of its jumps.

    Raises as :func:`configured_trajectory`.
    """
    if config.trajectory == "square":
        return _approved(*_flown(smooth_square(config), config), config)
    smooth = dataclasses.replace(config, waypoint_legs="minimum_snap")
    return configured_trajectory(smooth, read_bag=read_bag)


def _approved(trajectory: Trajectory, verdict: Verdict, config: ReferenceConfig) -> Trajectory:
    if trajectory.smooth and not verdict.feasible:
        raise ConfigurationError(
            f"{config.owner}.trajectory",
            config.trajectory,
            f"one within the vehicle's limits: {verdict.reason()}{_advice(config)}",
        )
    return trajectory


def judged_trajectory(
    config: ReferenceConfig, *, read_bag: BagReader | None = None
) -> tuple[Trajectory, Verdict]:
    """Return the same trajectory with the verdict on it, also when it is not feasible."""
    jumping = _jumping_trajectory(config)
    if jumping is not None:
        return jumping, _verdict(jumping, config)
    path = _path(config, read_bag)
    if config.time_scaling == "auto" and config.trajectory not in _NOT_SCALABLE:
        return _slowed(path, config)
    return _flown(path, config)


def limits_of(config: ReferenceConfig) -> Limits:
    """Return the limits that a configuration sets."""
    return Limits(
        throttle_min=config.throttle_min,
        throttle_max=config.throttle_max,
        omega_max=config.omega_max,
        margin=config.limit_margin,
    )


def _jumping_trajectory(config: ReferenceConfig) -> Trajectory | None:
    """Return a trajectory that is no path in motion, or None."""
    if config.trajectory == "hover":
        return Hover(config)
    if config.trajectory == "square":
        return square(config)
    if config.trajectory == "waypoints" and config.waypoint_legs == "jump":
        return Steps(
            configured_waypoints(config),
            dwell_time=config.dwell_time,
            yaw=config.yaw,
            closed=False,
        )
    return None


def _path(config: ReferenceConfig, read_bag: BagReader | None) -> Path:
    if config.trajectory in PATHS:
        return PATHS[config.trajectory](config)
    if not config.file:
        raise ConfigurationError(
            f"{config.owner}.file", config.file, f"the {config.trajectory} to fly"
        )
    file = FilePath(config.file).expanduser()
    if config.trajectory == "csv":
        return table_path(read_csv(file), config)
    if read_bag is None:
        raise ConfigurationError(
            f"{config.owner}.trajectory", config.trajectory, "one that needs no bag, here"
        )
    return table_path(read_bag(file), config)


def _flown(path: Path, config: ReferenceConfig) -> tuple[FlatTrajectory, Verdict]:
    try:
        trajectory = FlatTrajectory(path, gravity=config.gravity, drag=config.drag, yaw=config.yaw)
    except ValueError as error:
        raise ConfigurationError(
            f"{config.owner}.trajectory",
            config.trajectory,
            f"one within the vehicle's limits: {error}{_advice(config)}",
        ) from error
    return trajectory, _verdict(trajectory, config)


def _verdict(trajectory: Trajectory, config: ReferenceConfig) -> Verdict:
    return judged(trajectory, config.vehicle(), limits_of(config))


def _slowed(path: Path, config: ReferenceConfig) -> tuple[FlatTrajectory, Verdict]:
    """Return the path in the least time in which it is feasible, or as it is."""

    def tried(factor: float) -> tuple[FlatTrajectory, Verdict] | None:
        try:
            found = _flown(Slowed(path, factor), config)
        except ConfigurationError:  # free fall
            return None
        return found if found[1].feasible else None

    factor, last = 1.0, None
    while factor <= _LARGEST_FACTOR:
        last = tried(factor)
        if last is not None:
            break
        factor *= _GROWTH
    if last is None:
        return _flown(path, config)
    slow, quick = factor, factor / _GROWTH
    while factor > 1.0 and slow > _PRECISION * quick:
        middle = math.sqrt(slow * quick)
        found = tried(middle)
        if found is None:
            quick = middle
        else:
            slow, last = middle, found
    return last


def _advice(config: ReferenceConfig) -> str:
    if config.trajectory in _NOT_SCALABLE:
        return f"; change the parameters of {config.trajectory}"
    if config.time_scaling == "none":
        return "; slow it down, or set time_scaling to auto"
    return "; however slow"

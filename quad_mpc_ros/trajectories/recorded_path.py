"""A reference out of recorded positions: a table, or the odometry of a run flown before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.lie import Array
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.path import Chain, Path, Turned
from quad_mpc_ros.trajectories.polynomial import End, Leg, leg_within
from quad_mpc_ros.trajectories.smoothing import smooth_curve
from quad_mpc_ros.trajectories.spline_path import SplinePath

LEAST_POINTS = 6
_SLOW = 0.5  # m/s
_YAW_TOLERANCE = 0.01  # rad


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Positions over time, in the world.

    Shapes: ``seconds`` (n,) [s], increasing; ``p_WB`` (n, 3) [m]; ``yaw`` (n,) [rad] or None.
    ``source`` says where they come from, in errors.
    """

    source: str
    seconds: Array
    p_WB: Array
    yaw: Array | None = None

    def __post_init__(self) -> None:
        """Raise :class:`UserError` for too few points and for times that do not increase."""
        if len(self.seconds) < LEAST_POINTS:
            raise UserError(
                f"{self.source}: {len(self.seconds)} points, expected at least {LEAST_POINTS}"
            )
        values = [self.seconds[:, None], self.p_WB, *([] if self.yaw is None else [self.yaw])]
        for index in np.flatnonzero(~np.isfinite(np.column_stack(values)).all(axis=1))[:1]:
            raise UserError(f"{self.source}: point {index} (counted from 0) is not finite")
        for index in np.flatnonzero(np.diff(self.seconds) <= 0.0)[:1]:
            raise UserError(
                f"{self.source}: the time of point {index + 1} (counted from 0), "
                f"{self.seconds[index + 1]:g} s, is not after that of the point before, "
                f"{self.seconds[index]:g} s"
            )


def recorded_path(recording: Recording, config: ReferenceConfig) -> Path:
    """Return a smooth path along a recording, from rest to rest.

    The points are met within ``path_tolerance`` (root mean square) by the smoothest curve that
    does, so that the noise of a measurement does not become an acceleration. A recording that
    begins or ends slowly is taken to begin or end at rest. To any other minimum-snap legs within
    ``max_speed`` and ``max_acceleration`` are added, from rest to its first point, which is then
    reached later than the recording says, and from its last one to rest.
    """
    rests = _slow_ends(recording)
    points = recording.p_WB + np.array([*config.origin, 0.0])
    path = _smoothed(recording, points, tolerance=config.path_tolerance, rests=rests)
    turn = None
    if recording.yaw is not None:
        yaw = np.zeros((len(recording.yaw), 3))
        yaw[:, 0] = np.unwrap(recording.yaw)
        turn = _smoothed(recording, yaw, tolerance=_YAW_TOLERANCE, rests=rests)
    limits = {"max_speed": config.max_speed, "max_acceleration": config.max_acceleration}
    links: list[Path] = [_with_yaw(path, turn)]
    (start, end), rest = _ends(path), End.at_rest(None)
    if not rests[0]:
        leg = leg_within(rest, start, **limits)
        lead = turn and Leg(rest, _ends(turn)[0], duration=leg.duration)
        links.insert(0, _with_yaw(leg, lead))
    if not rests[1]:
        leg = leg_within(end, rest, **limits)
        lead = turn and Leg(_ends(turn)[1], rest, duration=leg.duration)
        links.append(_with_yaw(leg, lead))
    return Chain(links)


def _slow_ends(recording: Recording) -> tuple[bool, bool]:
    """Return whether the recording begins and whether it ends slowly."""
    steps = np.linalg.norm(np.diff(recording.p_WB, axis=0), axis=1)
    speeds = steps / np.diff(recording.seconds)
    return bool(speeds[0] < _SLOW), bool(speeds[-1] < _SLOW)


def _with_yaw(path: Path, turn: Path | None) -> Path:
    return path if turn is None else Turned(path, turn)


def _ends(path: SplinePath) -> tuple[End, End]:
    ends = path.at(np.array([0.0, path.duration]))
    return End.of(ends, 0), End.of(ends, 1)


def _smoothed(
    recording: Recording, values: Array, *, tolerance: float, rests: tuple[bool, bool]
) -> SplinePath:
    """Return the smooth curve near values (n, 3) at the times of the recording, from 0."""
    seconds = recording.seconds - recording.seconds[0]
    try:
        curve = smooth_curve(seconds, values, tolerance=tolerance, rests=rests)
    except ValueError as error:
        raise UserError(
            f"{recording.source}: {error} from its points, more than reference.path_tolerance, "
            f"{tolerance:g}: set that higher"
        ) from error
    return SplinePath(curve, duration=float(seconds[-1]))

"""A reference out of recorded positions: a table, or the odometry of a run flown before."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, splprep

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.path import Chain, Path, Turned
from quad_mpc_ros.references.polynomial import End, Leg, leg_within
from quad_mpc_ros.references.spline_path import SplinePath

_DEGREE = 5
LEAST_POINTS = _DEGREE + 1


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

    The points are met within ``path_tolerance`` (root mean square) by a smoothing spline of
    degree 5 (Dierckx's FITPACK), so that the noise of a measurement does not become an
    acceleration. Minimum-snap legs within ``max_speed`` and ``max_acceleration`` lead from rest
    to its first point, which is therefore reached later than the recording says, and to rest
    after its last one.
    """
    points = recording.p_WB + np.array([*config.origin, 0.0])
    path = _smoothed(recording, points, tolerance=config.path_tolerance)
    limits = {"max_speed": config.max_speed, "max_acceleration": config.max_acceleration}
    start, end = _ends(path)
    try:
        begin = leg_within(End.at_rest(None), start, **limits)
        stop = leg_within(end, End.at_rest(None), **limits)
    except ValueError as error:
        raise UserError(
            f"{recording.source}: no way from rest into its beginning or out of its end: {error}"
        ) from error
    if recording.yaw is None:
        return Chain([begin, path, stop])
    return Chain(_turned(recording, begin, path, stop))


def _turned(recording: Recording, begin: Leg, path: SplinePath, stop: Leg) -> list[Path]:
    """Return the three with the recorded yaw, which begins and ends at rest as well."""
    assert recording.yaw is not None
    yaw = np.zeros((len(recording.yaw), 3))
    yaw[:, 0] = np.unwrap(recording.yaw)
    turn = _smoothed(recording, yaw, tolerance=0.0)
    start, end = _ends(turn)
    return [
        Turned(begin, Leg(End.at_rest(None), start, duration=begin.duration)),
        Turned(path, turn),
        Turned(stop, Leg(end, End.at_rest(None), duration=stop.duration)),
    ]


def _ends(path: SplinePath) -> tuple[End, End]:
    ends = path.at(np.array([0.0, path.duration]))
    return End.of(ends, 0), End.of(ends, 1)


def _smoothed(recording: Recording, values: Array, *, tolerance: float) -> SplinePath:
    """Return the smooth curve near values (n, 3) at the times of the recording, from 0."""
    seconds = recording.seconds - recording.seconds[0]
    allowed = len(seconds) * tolerance**2
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            spline: Any
            spline, _ = splprep(values.T, u=seconds, k=_DEGREE, s=allowed, nest=-1)
        except (ValueError, RuntimeWarning) as error:
            raise UserError(
                f"{recording.source}: no smooth curve within {tolerance:g} m of its points; set "
                f"reference.path_tolerance higher ({' '.join(str(error).split())[:80]})"
            ) from error
    knots, coefficients, degree = spline
    curve = BSpline(knots, np.transpose(coefficients), degree)
    return SplinePath(curve, duration=float(seconds[-1]))

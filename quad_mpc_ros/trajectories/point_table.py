"""Positions over time, wherever they come from, made a path to fly.

From a recorded run, from a received message, or from a file of comma-separated values with the
units in the header:

    time [s], x [m], y [m], z [m], yaw [rad]
    0.00, 0.0, 0.0, 1.0, 0.0
    0.50, 0.1, 0.0, 1.0, 0.0

Positions are in the world (ENU). ``yaw [rad]`` may be left out, and the columns may be in any
order. Empty lines and lines that begin with ``#`` are passed over.
"""

from __future__ import annotations

import csv
import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.flat_trajectory import FlatTrajectory
from quad_mpc_ros.trajectories.flatness import yaw_of
from quad_mpc_ros.trajectories.minimum_snap import End, Leg, leg_within, snap_spline
from quad_mpc_ros.trajectories.path import Chain, Path, SplinePath, Turned
from quad_mpc_ros.trajectories.smoothing import smooth_curve

_LEAST_POINTS = 6
_SLOW = 0.5  # m/s
_YAW_TOLERANCE = 0.01  # rad
# Of a file.
_UNITS = {"time": "s", "x": "m", "y": "m", "z": "m", "yaw": "rad"}
_OPTIONAL = {"yaw"}
_HEADER = ", ".join(f"{name} [{unit}]" for name, unit in _UNITS.items())
# Of a message. The time to prepare it grows with the last two, and windows must go on meanwhile.
_QUATERNION_TOLERANCE = 1e-3
_LARGEST = 1e8  # m: room for map coordinates
_MOST_POINTS, _LONGEST = 1000, 600.0  # s


@dataclass(frozen=True, kw_only=True, eq=False)
class PointTable:
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
        if len(self.seconds) < _LEAST_POINTS:
            raise UserError(
                f"{self.source}: {len(self.seconds)} points, expected at least {_LEAST_POINTS}"
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


def table_path(table: PointTable, config: ReferenceConfig) -> Path:
    """Return a smooth path along a table, from rest to rest.

    The points are met within ``path_tolerance`` (root mean square) by the smoothest curve that
    does, so that the noise of a measurement does not become an acceleration. A table that
    begins or ends slowly is taken to begin or end at rest. To any other minimum-snap legs within
    ``max_speed`` and ``max_acceleration`` are added, from rest to its first point, which is then
    reached later than the table says, and from its last one to rest.
    """
    rests = _slow_ends(table)
    points = table.p_WB + np.array([*config.origin, 0.0])
    path = _smoothed(table, points, tolerance=config.path_tolerance, rests=rests)
    turn = None
    if table.yaw is not None:
        yaw = np.zeros((len(table.yaw), 3))
        yaw[:, 0] = np.unwrap(table.yaw)
        turn = _smoothed(table, yaw, tolerance=_YAW_TOLERANCE, rests=rests)
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


def _slow_ends(table: PointTable) -> tuple[bool, bool]:
    """Return whether the table begins and whether it ends slowly."""
    steps = np.linalg.norm(np.diff(table.p_WB, axis=0), axis=1)
    speeds = steps / np.diff(table.seconds)
    return bool(speeds[0] < _SLOW), bool(speeds[-1] < _SLOW)


def _with_yaw(path: Path, turn: Path | None) -> Path:
    return path if turn is None else Turned(path, turn)


def _ends(path: SplinePath) -> tuple[End, End]:
    ends = path.at(np.array([0.0, path.duration]))
    return End.of(ends, 0), End.of(ends, 1)


def _smoothed(
    table: PointTable, values: Array, *, tolerance: float, rests: tuple[bool, bool]
) -> SplinePath:
    """Return the smooth curve near values (n, 3) at the times of the table, from 0."""
    seconds = table.seconds - table.seconds[0]
    try:
        curve = smooth_curve(seconds, values, tolerance=tolerance, rests=rests)
    except ValueError as error:
        raise UserError(
            f"{table.source}: {error} from its points, more than reference.path_tolerance, "
            f"{tolerance:g}: set that higher"
        ) from error
    return SplinePath(curve, duration=float(seconds[-1]))


def pose_fault(
    *, frame_id: str, expected_frame_id: str, p_WB: Array, q_WB_xyzw: Array
) -> str | None:
    """Return why poses, positions (n, 3) and quaternions (n, 4), cannot be used."""
    if frame_id.removeprefix("/") != expected_frame_id.removeprefix("/"):
        return f"it is in frame '{frame_id}', expected '{expected_frame_id}'"
    # Written so that NaN, which compares with nothing, is refused.
    if not ((np.abs(p_WB) <= _LARGEST).all() and (np.abs(q_WB_xyzw) <= _LARGEST).all()):
        return f"it holds a number that is not finite or beyond {_LARGEST:g}"
    if (np.abs(np.linalg.norm(q_WB_xyzw, axis=1) - 1.0) > _QUATERNION_TOLERANCE).any():
        return "it holds a quaternion that is not of unit length"
    return None


def received_trajectory(window: ReferenceWindow, config: ReferenceConfig) -> FlatTrajectory:
    """Return the trajectory through the points of a message, at their times, from rest to rest.

    Positions and headings count; everything else follows from them by flatness. Few points are
    flown through by the path of least snap, more are smoothed as a table is. Raises
    :class:`UserError` or ``ValueError`` with the reason for what is no trajectory.
    """
    count = len(window.offset_ns)
    if not 2 <= count <= _MOST_POINTS:
        raise UserError(f"it has {count} points, expected 2 to {_MOST_POINTS}")
    fault = pose_fault(
        frame_id=window.frame_id,
        expected_frame_id=config.frame_id,
        p_WB=window.p_WB,
        q_WB_xyzw=window.q_WB_xyzw,
    )
    if fault is not None:
        raise UserError(fault)
    seconds = 1e-9 * window.offset_ns
    for index in np.flatnonzero(np.diff(window.offset_ns) <= 0)[:1]:
        raise UserError(
            f"the time of point {index + 1} (counted from 0), {seconds[index + 1]:g} s, is not "
            f"after that of the point before, {seconds[index]:g} s"
        )
    if seconds[-1] - seconds[0] > _LONGEST:
        raise UserError(f"it takes {seconds[-1] - seconds[0]:g} s, expected at most {_LONGEST:g}")
    R_WB = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw)
    yaw = np.unwrap([yaw_of(R) for R in R_WB])
    path = _through(seconds - seconds[0], window.p_WB, yaw, config)
    return FlatTrajectory(path, gravity=config.gravity, drag=config.drag)


def _through(seconds: Array, p_WB: Array, yaw: Array, config: ReferenceConfig) -> Path:
    if len(seconds) < _LEAST_POINTS:
        duration = float(seconds[-1])
        turn = np.column_stack((yaw, np.zeros((len(yaw), 2))))
        return Turned(
            SplinePath(snap_spline(p_WB, seconds), duration=duration),
            SplinePath(snap_spline(turn, seconds), duration=duration),
        )
    table = PointTable(source="the message", seconds=seconds, p_WB=p_WB, yaw=yaw)
    return table_path(table, dataclasses.replace(config, origin=(0.0, 0.0)))


def read_csv(path: FilePath) -> PointTable:
    """Return what a table says; raises :class:`UserError` with the line and the reason."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot be read: {error}") from error
    rows = [
        (number, [cell.strip() for cell in next(csv.reader([line]))])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not rows:
        raise UserError(f"{path}: empty, expected a header {_HEADER} and points")
    names = _column_names(path, *rows[0])
    values: dict[str, list[float]] = {name: [] for name in names}
    for number, cells in rows[1:]:
        if len(cells) != len(names):
            raise UserError(
                f"{path}: line {number}: {len(cells)} values, expected {len(names)} "
                f"({', '.join(names)})"
            )
        for name, cell in zip(names, cells, strict=True):
            values[name].append(_number(path, number, name, cell))
        if len(values["time"]) > 1 and not values["time"][-1] > values["time"][-2]:
            raise UserError(
                f"{path}: line {number}: time {values['time'][-1]:g} s is not after "
                f"{values['time'][-2]:g} s, that of the point before"
            )
    return PointTable(
        source=str(path),
        seconds=np.array(values["time"]),
        p_WB=np.column_stack([values[axis] for axis in "xyz"]),
        yaw=np.array(values["yaw"]) if "yaw" in values else None,
    )


def _column_names(path: FilePath, number: int, cells: list[str]) -> list[str]:
    names = []
    for cell in cells:
        name, _, unit = cell.partition("[")
        name, unit = name.strip(), unit.strip().removesuffix("]").strip()
        if name not in _UNITS or name in names:
            kind = "twice" if name in names else "unknown"
            raise UserError(f"{path}: line {number}: column {cell!r} {kind}, expected {_HEADER}")
        if unit != _UNITS[name]:
            raise UserError(
                f"{path}: line {number}: column {cell!r}, expected '{name} [{_UNITS[name]}]'"
            )
        names.append(name)
    missing = [name for name in _UNITS if name not in names and name not in _OPTIONAL]
    if missing:
        raise UserError(
            f"{path}: line {number}: no column {', '.join(missing)}, expected {_HEADER}"
        )
    return names


def _number(path: FilePath, number: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f"{path}: line {number}: {name} is {cell!r}, expected a finite number")
    return value

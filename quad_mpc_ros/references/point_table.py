# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Paths from positions over time.

Points come from a message or a file of comma-separated values with units in the header:

    time [s], x [m], y [m], z [m], yaw [rad]
    0.00, 0.0, 0.0, 1.0, 0.0
    0.50, 0.1, 0.0, 1.0, 0.0

Positions are in the world (ENU). ``yaw [rad]`` may be omitted, and the columns may be in any
order. Empty lines and lines that begin with ``#`` are skipped. With the columns of a whole motion
(:mod:`quad_mpc_ros.references.motion_table`) instead of yaw, the motion is flown unchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from quad_mpc_ros.configuration import (
    ConfigurationError,
    UserError,
    files,
    optional_part,
    parameter,
)
from quad_mpc_ros.configuration.errors import text_of
from quad_mpc_ros.configuration.text_files import read_csv_table
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import (
    End,
    Leg,
    LegParameters,
    leg_within,
)
from quad_mpc_ros.references.motion_table import (
    MOTION_UNITS,
    MotionTable,
    PlannedMotion,
)
from quad_mpc_ros.references.path import Chain, Path, RestPath, SplinePath, Turned

LEAST_POINTS = 6
_SLOW = 0.5  # m/s
_YAW_TOLERANCE = 0.01  # rad
_UNITS = {"time": "s", "x": "m", "y": "m", "z": "m", "yaw": "rad"}
_OPTIONAL = {"yaw"}
_ALL_UNITS = {**_UNITS, **MOTION_UNITS}
_LONGEST_STEP = 10.0  # s, between points, as a rule
_LARGEST = 1e20  # of any number, so that sums of squares are finite
_LATEST = 1e11  # s: later than any date
_OTHER_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_HEADER = (
    ", ".join(f"{name} [{unit}]" for name, unit in _UNITS.items())
    + f", or in place of yaw all of {', '.join(MOTION_UNITS)}"
)


@dataclass(frozen=True, kw_only=True)
class TableParameters(LegParameters):
    """Source of the points, and tolerance of the path."""

    file: str = parameter(
        "",
        doc="csv: table to fly. gates: plan from quad_mpc plan; if empty, a smooth path is flown.",
    )
    path_tolerance: float = parameter(
        0.005,
        doc="csv: largest RMS distance of the smooth curve from the points.",
        unit="m",
        above=0.0,
        advanced=True,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class PointTable:
    """Positions over time, in the world.

    Shapes: ``seconds`` (n,) [s], increasing; ``p_WB`` (n, 3) [m]; ``yaw`` (n,) [rad] or None.
    ``source`` is their origin, for errors.
    """

    source: str
    seconds: Array
    p_WB: Array
    yaw: Array | None = None

    def __post_init__(self) -> None:
        """Raise :class:`UserError` for too few points."""
        if len(self.seconds) < LEAST_POINTS:
            raise UserError(
                f"{self.source}: {len(self.seconds)} points, expected at least {LEAST_POINTS}"
            )


def check_increasing(seconds: Array) -> None:
    """Raise :class:`UserError` for times (n,) [s] that do not increase."""
    for index in np.flatnonzero(np.diff(seconds) <= 0.0)[:1]:
        raise UserError(
            f"the time of point {index + 1} (counted from 0), {seconds[index + 1]:g} s, "
            f"is not after the time of the previous point, {seconds[index]:g} s"
        )


def csv_path(config: TableParameters) -> Path | PlannedMotion:
    """Return the path along the configured file, or the motion in it."""
    if not config.file:
        raise ConfigurationError(f"{config.owner}.file", config.file, "the csv to fly")
    table = read_csv(files.expanded(config.file))
    if isinstance(table, MotionTable):
        return PlannedMotion(table, offset=np.array([*config.origin, 0.0]))
    return table_path(table, config)


def table_path(table: PointTable, config: TableParameters) -> Path:
    """Return a smooth path along a table, from rest to rest.

    The path is the smoothest curve within ``path_tolerance`` (root mean square) of the points, so
    that measurement noise does not become an acceleration. A table that starts or ends slowly is
    assumed to start or end at rest. Otherwise minimum-snap legs within ``max_speed`` and
    ``max_acceleration`` are added, from rest to the first point, which is then reached later, and
    from the last point to rest.
    """
    rests = _slow_ends(table)
    points = table.p_WB + np.array([*config.origin, 0.0])
    path = _smoothed(table, points, tolerance=config.path_tolerance, rests=rests)
    turn: Path = RestPath(np.zeros(3), duration=path.duration)
    if table.yaw is not None:
        yaw = np.zeros((len(table.yaw), 3))
        yaw[:, 0] = np.unwrap(table.yaw)
        turn = _smoothed(table, yaw, tolerance=_YAW_TOLERANCE, rests=rests)
    limits = {"max_speed": config.max_speed, "max_acceleration": config.max_acceleration}
    links: list[Path] = [Turned(path, turn)]
    (start, end), rest = _ends(path), End.at_rest(None)
    if not rests[0]:
        leg = leg_within(rest, start, **limits)
        links.insert(0, Turned(leg, Leg(rest, _ends(turn)[0], duration=leg.duration)))
    if not rests[1]:
        leg = leg_within(end, rest, **limits)
        links.append(Turned(leg, Leg(_ends(turn)[1], rest, duration=leg.duration)))
    return Chain(links)


def _slow_ends(table: PointTable) -> tuple[bool, bool]:
    """Return whether the table starts slowly and whether it ends slowly."""
    steps = np.linalg.norm(np.diff(table.p_WB, axis=0), axis=1)
    speeds = steps / np.diff(table.seconds)
    return bool(speeds[0] < _SLOW), bool(speeds[-1] < _SLOW)


def _ends(path: Path) -> tuple[End, End]:
    ends = path.at(np.array([0.0, path.duration]))
    return End.of(ends, 0), End.of(ends, 1)


def _smoothed(
    table: PointTable, values: Array, *, tolerance: float, rests: tuple[bool, bool]
) -> SplinePath:
    """Return the smooth curve near values (n, 3) at the times of the table, from 0."""
    from quad_mpc_ros.references.smoothing import smooth_curve  # SciPy's splines, for it alone

    seconds = table.seconds - table.seconds[0]
    try:
        curve = smooth_curve(seconds, values, tolerance=tolerance, rests=rests)
    except ValueError as error:
        raise UserError(
            f"{table.source}: {error} from its points, more than "
            f"reference.advanced.path_tolerance, {tolerance:g}: increase this parameter"
        ) from error
    return SplinePath(curve, duration=float(seconds[-1]))


def read_csv(path: FilePath) -> PointTable | MotionTable:
    """Return the points or the motion of a file.

    Raises :class:`UserError` with the line and the reason.
    """
    rows = read_csv_table(path)
    if not rows:
        raise UserError(f"{path}: empty, expected a header {_HEADER} and points")
    names = _column_names(path, *rows[0])
    values: dict[str, list[float]] = {name: [] for name in names}
    for number, cells in rows[1:]:
        if len(cells) != len(names):
            hint = "; write decimals with a point" if len(cells) == 2 * len(names) else ""
            raise UserError(
                f"{path}: line {number}: {len(cells)} values, expected {len(names)} "
                f"({', '.join(names)}){hint}"
            )
        for name, cell in zip(names, cells, strict=True):
            values[name].append(_number(path, number, name, cell))
        if len(values["time"]) > 1 and not values["time"][-1] > values["time"][-2]:
            raise UserError(
                f"{path}: line {number}: time {values['time'][-1]:g} s is not after "
                f"{values['time'][-2]:g} s, the time of the previous point"
            )
    _refuse_other_unit(path, np.array(values["time"]))
    points = PointTable(
        source=str(path),
        seconds=np.array(values["time"]),
        p_WB=_columns(values, "x", "y", "z"),
        yaw=np.array(values["yaw"]) if "yaw" in values else None,
    )
    if "vx" not in values:
        return points
    return MotionTable(
        source=str(path),
        seconds=points.seconds,
        p_WB=points.p_WB,
        v_WB_W=_columns(values, "vx", "vy", "vz"),
        a_WB_W=_columns(values, "ax", "ay", "az"),
        q_WB_xyzw=_columns(values, "qx", "qy", "qz", "qw"),
        w_WB_B=_columns(values, "wx", "wy", "wz"),
    )


def _columns(values: dict[str, list[float]], *names: str) -> Array:
    return np.column_stack([values[name] for name in names])


def _column_names(path: FilePath, number: int, cells: list[str]) -> list[str]:
    names = []
    for cell in cells:
        name, _, unit = cell.partition("[")
        name, unit = name.strip(), unit.strip().removesuffix("]").strip()
        if _ALL_UNITS.get(name) != unit or name in names:
            raise UserError(
                f"{path}: line {number}: column {text_of(cell)}, expected {_HEADER}, each once"
            )
        names.append(name)
    required = [name for name in _UNITS if name not in _OPTIONAL]
    if not MOTION_UNITS.keys().isdisjoint(names):
        required += MOTION_UNITS
    missing = [name for name in required if name not in names]
    if missing:
        raise UserError(
            f"{path}: line {number}: no column {', '.join(missing)}, expected {_HEADER}"
        )
    return names


def _number(path: FilePath, number: int, name: str, cell: str) -> float:
    try:
        value = math.nan if "_" in cell else float(cell)
    except ValueError:
        value = math.nan
    if not abs(value) <= _LARGEST:  # NaN is not
        raise UserError(
            f"{path}: line {number}: {name} is {text_of(cell)}, expected a finite number, with a "
            "decimal point"
        )
    return value


def _refuse_other_unit(path: FilePath, seconds: Array) -> None:
    """Reject times that are not in seconds: too far apart, or too late for a date."""
    if len(seconds) < LEAST_POINTS:
        return
    step = float(np.median(np.diff(seconds)))
    if step > _LONGEST_STEP or seconds[0] > _LATEST:
        unit = min(_OTHER_UNITS, key=lambda unit: abs(math.log(_OTHER_UNITS[unit] * step / 0.05)))
        raise UserError(
            f"{path}: time begins at {seconds[0]:.10g} s in steps of {step:.10g} s and looks like "
            f"{unit}, expected seconds in steps of {_LONGEST_STEP:g} s at most: multiply it by "
            f"{_OTHER_UNITS[unit]:g}"
        )


@dataclass(frozen=True, kw_only=True)
class GateParameters(TableParameters):
    """Parameters of a course of gates."""

    gates: str = parameter(
        "",
        doc="gates: file of the gates, or the content of the file in braces. With another "
        "trajectory the gates are only drawn, and their passages evaluated.",
    )


def gates_path(config: GateParameters) -> Path | PlannedMotion:
    """Return the plan that ``file`` names, or the smooth path through the gates.

    Raises :class:`UserError` for an infeasible course, a plan that does not pass the course, and
    if racing is not installed.
    """
    make = optional_part("gates_path", needed_by=f"{config.owner}.trajectory")
    path: Path | PlannedMotion = make(config)
    return path

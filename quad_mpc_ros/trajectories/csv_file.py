"""Reading a trajectory from a table: comma-separated values with the units in the header.

    time [s], x [m], y [m], z [m], yaw [rad]
    0.00, 0.0, 0.0, 1.0, 0.0
    0.50, 0.1, 0.0, 1.0, 0.0

Positions are in the world (ENU). ``yaw [rad]`` may be left out, and the columns may be in any
order. Empty lines and lines that begin with ``#`` are passed over.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.trajectories.recorded_path import Recording

_UNITS = {"time": "s", "x": "m", "y": "m", "z": "m", "yaw": "rad"}
_OPTIONAL = {"yaw"}
_HEADER = ", ".join(f"{name} [{unit}]" for name, unit in _UNITS.items())


def read_csv(path: Path) -> Recording:
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
    return Recording(
        source=str(path),
        seconds=np.array(values["time"]),
        p_WB=np.column_stack([values[axis] for axis in "xyz"]),
        yaw=np.array(values["yaw"]) if "yaw" in values else None,
    )


def _column_names(path: Path, number: int, cells: list[str]) -> list[str]:
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


def _number(path: Path, number: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f"{path}: line {number}: {name} is {cell!r}, expected a finite number")
    return value

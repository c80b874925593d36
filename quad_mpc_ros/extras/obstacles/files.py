"""Obstacle files.

    obstacles:
      - {shape: box, position: [4.0, 0.0, 1.5], size: [0.4, 0.4, 3.0], yaw: 0.3}
      - {shape: cylinder, position: [6.0, 1.0, 1.0], radius: 0.2, height: 2.0}
      - {shape: sphere, position: [8.0, 0.0, 2.0], radius: 0.5, velocity: [0.0, 1.0, 0.0]}
    volume: {minimum: [-1.0, -5.0, 0.0], maximum: [12.0, 5.0, 4.0]}

Positions are centres [m] in the frame of the odometry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError, files, ros_yaml
from quad_mpc_ros.configuration.box import FARTHEST
from quad_mpc_ros.configuration.errors import text_of
from quad_mpc_ros.configuration.spelling import did_you_mean
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.obstacles.surfaces import area
from quad_mpc_ros.simulation.scene import Scene, Volume
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Shape, Sphere

_SHAPE_KEYS = {"box": ("size",), "cylinder": ("radius", "height"), "sphere": ("radius",)}
_COMMON_KEYS = ("shape", "position", "yaw", "velocity", "appears_at")
_MAX_TOTAL_AREA = 20_000.0  # m^2: two million points
_FILE_KEYS = ("obstacles", "volume")


def read_scene(path: Path | str) -> Scene:
    """Return the scene in a file. Raises :class:`UserError` with the entry and expected value."""
    content = ros_yaml.read_file(Path(path))
    return scene_of(content, str(path))


def scene_of_file(file: str) -> Scene:
    """Return the scene in the file of a parameter; an empty scene if it is not set."""
    return read_scene(files.expanded(file)) if file else Scene()


def scene_of(content: object, where: str) -> Scene:
    """Return the scene in the content of a file; ``where`` is the prefix of errors."""
    if not isinstance(content, Mapping):
        raise UserError(f"{where}: given {text_of(content)}, expected 'obstacles:' with a list")
    _refuse_unknown(content, _FILE_KEYS, where)
    entries = content.get("obstacles", [])
    if not isinstance(entries, list):
        raise UserError(f"{where}: obstacles: given {text_of(entries)}, expected a list")
    shapes = [
        _shape(entry, f"{where}: obstacle {number}") for number, entry in enumerate(entries, 1)
    ]
    whole = sum(area(shape) for shape in shapes)
    if whole > _MAX_TOTAL_AREA:
        raise UserError(
            f"{where}: obstacles: given surfaces of {whole:.0f} m^2 in all, expected "
            f"{_MAX_TOTAL_AREA:.0f} m^2 at most; leave out the ground and what is far away"
        )
    given = content.get("volume")
    return Scene(shapes, None if given is None else _volume(given, f"{where}: volume"))


def _shape(entry: object, where: str) -> Shape:
    if not isinstance(entry, Mapping):
        raise UserError(f"{where}: given {text_of(entry)}, expected {{shape: box, position: …}}")
    kind = entry.get("shape")
    if not isinstance(kind, str) or kind not in _SHAPE_KEYS:
        raise UserError(
            f"{where}: shape: given {text_of(kind)}, expected one of {', '.join(_SHAPE_KEYS)}"
            f"{did_you_mean(str(kind), _SHAPE_KEYS)}"
        )
    _refuse_unknown(entry, (*_COMMON_KEYS, *_SHAPE_KEYS[kind]), where)
    common: dict[str, Any] = {
        "p_WO": _vector(entry, "position", where),
        "R_WO": rotation_about_z(_number(entry, "yaw", where, default=0.0)),
        "v_WO_W": _vector(entry, "velocity", where, default=(0.0, 0.0, 0.0)),
        "appears_at": _number(entry, "appears_at", where, default=0.0, minimum=0.0),
    }
    if kind == "box":
        size = _vector(entry, "size", where)
        if not (size > 0.0).all():
            raise UserError(
                f"{where}: size: given {text_of(entry['size'])}, expected 3 numbers > 0"
            )
        return Box(size=size, **common)
    radius = _number(entry, "radius", where, above=0.0)
    if kind == "sphere":
        return Sphere(radius=radius, **common)
    return Cylinder(radius=radius, height=_number(entry, "height", where, above=0.0), **common)


def rotation_about_z(yaw: float) -> Array:
    """Return the rotation (3, 3) about the vertical by an angle [rad]."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _volume(given: object, where: str) -> Volume:
    if not isinstance(given, Mapping):
        raise UserError(f"{where}: given {text_of(given)}, expected {{minimum: …, maximum: …}}")
    _refuse_unknown(given, ("minimum", "maximum"), where)
    minimum, maximum = (_vector(given, name, where) for name in ("minimum", "maximum"))
    if not (minimum < maximum).all():
        raise UserError(
            f"{where}: minimum: given {text_of(given['minimum'])}, expected 3 numbers below "
            f"maximum {text_of(given['maximum'])}"
        )
    return Volume(minimum=minimum, maximum=maximum)


def _refuse_unknown(given: Mapping[Any, Any], known: tuple[str, ...], where: str) -> None:
    for name in given:
        if name not in known:
            raise UserError(
                f"{where}: given {text_of(name)}, expected {', '.join(known)}"
                f"{did_you_mean(str(name), known)}"
            )


def _vector(
    given: Mapping[Any, Any], name: str, where: str, *, default: tuple[float, ...] | None = None
) -> Array:
    value = given.get(name, default)
    usable = isinstance(value, list | tuple) and len(value) == 3 and all(map(_usable, value))
    if not usable:
        raise UserError(f"{where}: {name}: {_given(given, name)}, expected 3 numbers")
    return np.array(value, dtype=np.float64)


def _number(
    given: Mapping[Any, Any],
    name: str,
    where: str,
    *,
    default: float | None = None,
    above: float = -math.inf,
    minimum: float = -math.inf,
) -> float:
    value = given.get(name, default)
    if not (_usable(value) and value > above and value >= minimum):
        bound = f" > {above:g}" if above > -math.inf else ""
        bound += f" >= {minimum:g}" if minimum > -math.inf else ""
        raise UserError(f"{where}: {name}: {_given(given, name)}, expected a number{bound}")
    return float(value)


def _given(given: Mapping[Any, Any], name: str) -> str:
    return f"given {text_of(given[name])}" if name in given else "given none"


def _usable(value: object) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= FARTHEST  # NaN compares with nothing

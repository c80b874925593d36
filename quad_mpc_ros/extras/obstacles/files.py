# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
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
from quad_mpc_ros.configuration.errors import text_of
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.obstacles.surfaces import area
from quad_mpc_ros.extras.yaml_entries import Entry
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Scene, Shape, Sphere, Volume

_SHAPE_KEYS = {"box": ("size",), "cylinder": ("radius", "height"), "sphere": ("radius",)}
_COMMON_KEYS = ("shape", "position", "yaw", "velocity", "appears_at")
_MAX_TOTAL_AREA = 20_000.0  # m^2: two million points


def read_scene(path: Path | str) -> Scene:
    """Return the scene in a file. Raises :class:`UserError` with the entry and expected value."""
    return scene_of(ros_yaml.read_file(Path(path)), str(path))


def scene_of_file(file: str) -> Scene:
    """Return the scene in the file of a parameter; an empty scene if the parameter is not set."""
    return read_scene(files.expanded(file)) if file else Scene()


def scene_of(content: object, source: str) -> Scene:
    """Return the scene in the content of a file; ``source`` is the prefix of errors."""
    if not isinstance(content, Mapping):
        raise UserError(f"{source}: given {text_of(content)}, expected 'obstacles:' with a list")
    entry = Entry(content, source=source)
    entry.check_keys(("obstacles", "volume"))
    rows = entry.get("obstacles", [])
    if not isinstance(rows.value, list):
        raise rows.error("a list")
    shapes = [_shape(row) for row in rows.items("a list")] if rows.value else []
    whole = sum(area(shape) for shape in shapes)
    if whole > _MAX_TOTAL_AREA:
        raise UserError(
            f"{source}: obstacles: given surfaces of {whole:.0f} m^2 in all, expected "
            f"{_MAX_TOTAL_AREA:.0f} m^2 at most; omit the ground and distant obstacles"
        )
    return Scene(shapes, _volume(entry.get("volume")) if "volume" in content else None)


def _shape(entry: Entry) -> Shape:
    if not isinstance(entry.value, Mapping):
        raise entry.error("{shape: box, position: …}")
    kind = entry.value.get("shape")
    if not isinstance(kind, str) or kind not in _SHAPE_KEYS:
        raise entry.error(f"one of {', '.join(_SHAPE_KEYS)}", key="shape")
    entry.check_keys((*_COMMON_KEYS, *_SHAPE_KEYS[kind]))
    common: dict[str, Any] = {
        "p_WO": entry.get("position").vector(),
        "R_WO": rotation_about_z(entry.get("yaw", 0.0).number()),
        "v_WO_W": entry.get("velocity", [0.0, 0.0, 0.0]).vector(),
        "appears_at": entry.get("appears_at", 0.0).number(least=0.0),
    }
    if kind == "box":
        size = entry.get("size").vector()
        if not (size > 0.0).all():
            raise entry.error("3 numbers > 0", key="size")
        return Box(size=size, **common)
    radius = entry.get("radius").number(above=0.0)
    if kind == "sphere":
        return Sphere(radius=radius, **common)
    return Cylinder(radius=radius, height=entry.get("height").number(above=0.0), **common)


def rotation_about_z(yaw: float) -> Array:
    """Return the rotation (3, 3) about the vertical by an angle [rad]."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _volume(entry: Entry) -> Volume:
    entry.check_keys(("minimum", "maximum"))
    minimum, maximum = (entry.get(name).vector() for name in ("minimum", "maximum"))
    if not (minimum < maximum).all():
        below = text_of(entry.value["maximum"])
        raise entry.error(f"3 numbers below maximum {below}", key="minimum")
    return Volume(minimum=minimum, maximum=maximum)

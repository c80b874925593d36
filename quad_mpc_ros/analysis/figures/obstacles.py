# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles in figures, at the time of closest approach."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Shape

COLOUR = "#D55E00"

_MAX_DISTANCE = 3.0  # m from the flight
_CIRCLE_CORNERS = 24  # corners of a circle
_SPHERE_RINGS = 8  # of a sphere
_MAX_SHAPES = 400


def drawn_shapes(flight: Flight) -> list[Shape]:
    """Return the nearest obstacles of a flight, at their times of closest approach."""
    if flight.scene is None:
        return []
    found = []
    for shape in flight.scene.shapes:
        moved = np.maximum(flight.time - shape.appears_at, 0.0)[:, None] * shape.v_WO_W
        away = shape.distance(flight.p_WB - moved)
        away = np.where(flight.time >= shape.appears_at, away, np.inf)
        nearest = int(np.argmin(away))
        if away[nearest] <= _MAX_DISTANCE:
            found.append((float(away[nearest]), shape.after(float(flight.time[nearest]))))
    found.sort(key=lambda each: each[0])
    return [shape for _, shape in found[:_MAX_SHAPES]]


def extent(shapes: list[Shape]) -> Array:
    """Return points (n, 3) [m] that span the shapes."""
    ends = [p for shape in shapes for face in faces(shape) for p in face]
    return np.array(ends).reshape(-1, 3)


def faces(shape: Shape) -> list[Array]:
    """Return the faces of a shape as polygons (k, 3) [m]."""
    x, y, z = shape.half_extents
    turn = np.linspace(0.0, 2.0 * math.pi, _CIRCLE_CORNERS, endpoint=False)
    if isinstance(shape, Box):
        square = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
        rings = [(square, -z), (square, z)]
    elif isinstance(shape, Cylinder):
        circle = np.column_stack((x * np.cos(turn), x * np.sin(turn)))
        rings = [(circle, -z), (circle, z)]
    else:
        circle = np.column_stack((np.cos(turn), np.sin(turn)))
        latitudes = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _SPHERE_RINGS)
        rings = [(x * math.cos(up) * circle, x * math.sin(up)) for up in latitudes]
    lofted = [np.column_stack((ring, np.full(len(ring), height))) for ring, height in rings]
    found = [lofted[0], lofted[-1]]
    for low, high in itertools.pairwise(lofted):
        ahead_low, ahead_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        found += list(np.stack((low, ahead_low, ahead_high, high), axis=1))
    return [face @ shape.R_WO.T + shape.p_WO for face in found]


def draw(axes: Any, shapes: list[Shape], *, zorder: int) -> None:
    """Draw translucent shapes into mplot3d axes."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    for number, shape in enumerate(shapes):
        axes.add_collection(
            Poly3DCollection(
                faces(shape),
                facecolors=(*style.rgb(COLOUR), 0.16),
                edgecolors=(*style.rgb(COLOUR), 0.35),
                linewidths=0.4,
                zorder=zorder,
                label="obstacle" if number == 0 else None,
            )
        )

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Sampled points and areas of the surfaces of shapes."""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Shape, Sphere, Volume

_WALL_TOLERANCE = 1e-6  # m from a wall


def area(shape: Shape) -> float:
    """Return the area of a shape's surface [m^2]."""
    if isinstance(shape, Box):
        a, b, c = shape.size.tolist()
        return float(2.0 * (a * b + b * c + c * a))
    if isinstance(shape, Cylinder):
        return 2.0 * math.pi * shape.radius * (shape.radius + shape.height)
    assert isinstance(shape, Sphere)
    return 4.0 * math.pi * shape.radius**2


def surface_points(shape: Shape, spacing: float) -> Array:
    """Return about :func:`area` / ``spacing``^2 points (n, 3) [m] on a surface at time 0.

    Every point of the surface is within ``spacing`` / sqrt(2) [m] of a sample.
    """
    if isinstance(shape, Box):
        points = _on_box(shape, spacing)
    elif isinstance(shape, Cylinder):
        points = _on_cylinder(shape, spacing)
    else:
        assert isinstance(shape, Sphere)
        points = _on_sphere(shape, spacing)
    return np.asarray(points @ shape.R_WO.T + shape.p_WO)


def wall_points(volume: Volume, spacing: float, *, near: Array, radius: float) -> Array:
    """Return points (n, 3) [m] on walls and ceiling within a cube around a position (3,).

    Also on a floor above 0; a vehicle may stand on ground at height 0 or below.
    """
    low = np.maximum(volume.minimum, near - radius)
    high = np.minimum(volume.maximum, near + radius)
    if not (low < high).all():
        return np.zeros((0, 3))
    points = surface_points(Box(p_WO=0.5 * (low + high), size=high - low), spacing)
    floor = volume.minimum.copy()
    floor[2] = floor[2] if floor[2] > 0.0 else -np.inf
    on_wall = (points <= floor + _WALL_TOLERANCE) | (points >= volume.maximum - _WALL_TOLERANCE)
    return points[on_wall.any(axis=1)]


def _on_box(box: Box, spacing: float) -> Array:
    """Return points (n, 3) [m] on the six faces, including edges and corners."""
    a, b, c = (_steps(length, spacing) for length in box.size)
    ends_x, ends_y, ends_z = (np.array([-h, h]) for h in box.half_extents)
    faces = [_grid(ends_x, b, c), _grid(a, ends_y, c), _grid(a, b, ends_z)]
    return np.unique(np.vstack(faces), axis=0)


def _on_cylinder(cylinder: Cylinder, spacing: float) -> Array:
    """Return points (n, 3) [m] on the wall and the two ends, including rims."""
    heights = _steps(cylinder.height, spacing)
    wall = _crossed(_circle(cylinder.radius, spacing), heights)
    radii = _steps(2.0 * cylinder.radius, spacing)
    discs = [_circle(radius, spacing) for radius in radii[(radii >= 0.0)][:-1]]
    ends = _crossed(np.vstack([np.zeros((1, 2)), *discs]), heights[[0, -1]])
    return np.vstack((wall, ends))


def _on_sphere(sphere: Sphere, spacing: float) -> Array:
    """Return points (n, 3) [m] on circles of latitude."""
    count = max(math.ceil(math.pi * sphere.radius / spacing), 2)
    rings = []
    for latitude in np.linspace(-0.5 * math.pi, 0.5 * math.pi, count + 1):
        circle = _circle(sphere.radius * math.cos(latitude), spacing)
        rings.append(_crossed(circle, np.array([sphere.radius * math.sin(latitude)])))
    return np.vstack(rings)


def _steps(length: float, spacing: float) -> Array:
    """Return positions along a length centred at 0, at most ``spacing`` apart."""
    half = 0.5 * length
    return np.linspace(-half, half, max(math.ceil(length / spacing), 1) + 1)


def _grid(x: Array, y: Array, z: Array) -> Array:
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)


def _circle(radius: float, spacing: float) -> Array:
    """Return points (n, 2) on a circle, one point for a radius of 0."""
    count = math.ceil(2.0 * math.pi * radius / spacing)
    if count < 2:
        return np.zeros((1, 2))
    turn = np.linspace(0.0, 2.0 * math.pi, max(count, 6), endpoint=False)
    return radius * np.column_stack((np.cos(turn), np.sin(turn)))


def _crossed(places: Array, heights: Array) -> Array:
    """Return every position (n, 2) at every height (m,) as points (n m, 3)."""
    across = np.tile(places, (len(heights), 1))
    return np.column_stack((across, np.repeat(heights, len(places))))

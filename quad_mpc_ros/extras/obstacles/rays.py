"""Exact intersection of rays with shapes, by the slab method.

Kay and Kajiya, SIGGRAPH 1986.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Shape, Sphere

_TINY = 1e-12


def ray_lengths(shape: Shape, p_WC: Array, directions_W: Array) -> Array:
    """Return the lengths (n,) [m] of rays (n, 3), unit vectors, from a point (3,) [m] to a shape.

    Infinite for rays that miss the shape; 0 from inside.
    """
    p_OC = shape.turned((p_WC - shape.p_WO)[None])[0]
    directions_O = shape.turned(directions_W)
    if isinstance(shape, Box):
        enters, leaves = _slabs(p_OC, directions_O, shape.half_extents)
        return _first_meeting(enters.max(axis=1), leaves.min(axis=1))
    if isinstance(shape, Cylinder):
        return _to_cylinder(shape, p_OC, directions_O)
    assert isinstance(shape, Sphere)
    return _first_meeting(*_through_round(p_OC, directions_O, shape.radius))


def _to_cylinder(cylinder: Cylinder, p_OC: Array, directions_O: Array) -> Array:
    across, at = directions_O[:, :2], p_OC[:2]
    enters, leaves = _through_round(at, across, cylinder.radius)
    from_end, to_end = _slabs(p_OC[2:], directions_O[:, 2:], np.array([0.5 * cylinder.height]))
    return _first_meeting(np.maximum(enters, from_end[:, 0]), np.minimum(leaves, to_end[:, 0]))


def _slabs(p: Array, directions: Array, half: Array) -> tuple[Array, Array]:
    """Return the lengths at which rays enter and leave the slab |x| < half of each axis (n, k)."""
    steep = np.where(np.abs(directions) < _TINY, np.copysign(_TINY, directions), directions)
    first, second = (-half - p) / steep, (half - p) / steep
    return np.minimum(first, second), np.maximum(first, second)


def _through_round(p: Array, directions: Array, radius: float) -> tuple[Array, Array]:
    """Return the lengths at which rays enter and leave a circle or sphere around 0."""
    a = np.maximum(np.einsum("ni,ni->n", directions, directions), _TINY**2)
    b = directions @ p
    c = float(p @ p) - radius * radius
    square = b * b - a * c
    root = np.sqrt(np.maximum(square, 0.0))
    meets = square >= 0.0
    enters = np.where(meets, (-b - root) / a, np.inf)
    leaves = np.where(meets, (-b + root) / a, -np.inf)
    return enters, leaves


def _first_meeting(enters: Array, leaves: Array) -> Array:
    meets = (enters <= leaves) & (leaves >= 0.0)
    return np.where(meets, np.maximum(enters, 0.0), np.inf)

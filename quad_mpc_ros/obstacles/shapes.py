"""Boxes, cylinders and spheres: distances to their surface, points on it, rays that meet it.

A shape has a frame O in its centre, with ``p_WO``, ``R_WO`` and a constant velocity ``v_WO_W``.
Distances are signed: negative inside. The formulas are the exact ones of signed distance functions
(Quilez, distance functions) and of rays that enter a slab (Kay and Kajiya, SIGGRAPH 1986).
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from quad_mpc_ros.control.lie import Array

_TINY = 1e-12


def _zero() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape(ABC):
    """What all shapes have.

    Attributes:
        p_WO: Its centre (3,) [m], at the time 0.
        R_WO: Its attitude (3, 3).
        v_WO_W: Its velocity (3,) [m/s], constant.
        appears_at: When it is there [s]; before, it is not.
    """

    p_WO: Array
    R_WO: Array = field(default_factory=lambda: np.eye(3))
    v_WO_W: Array = field(default_factory=_zero)
    appears_at: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether it has a velocity."""
        return bool(np.any(self.v_WO_W))

    @property
    @abstractmethod
    def half_extents(self) -> Array:
        """Half of its size (3,) [m] along its own axes."""

    @property
    @abstractmethod
    def outer_radius(self) -> float:
        """Radius [m] of the smallest sphere about the centre that holds it."""

    @property
    @abstractmethod
    def area(self) -> float:
        """Area of its surface [m^2]."""

    @abstractmethod
    def surface_points(self, spacing: float) -> Array:
        """Return points (n, 3) [m] on its surface at the time 0, about ``area`` / ``spacing``^2.

        Every point of the surface has one within ``spacing`` / sqrt(2) [m].
        """

    def after(self, seconds: float) -> Shape:
        """Return it where it is that much later [s]; before it appears it waits at its start."""
        moved = max(seconds - self.appears_at, 0.0)
        if not self.moves or moved == 0.0:
            return self
        return dataclasses.replace(self, p_WO=self.p_WO + moved * self.v_WO_W)

    def distance(self, p_WQ: Array) -> Array:
        """Return the signed distances (n,) [m] of points (n, 3) [m] to its surface."""
        return self._distance(self._turned(p_WQ - self.p_WO))

    def ray_lengths(self, p_WC: Array, directions_W: Array) -> Array:
        """Return how far rays (n, 3), of unit length, go from a point (3,) [m] until they meet it.

        Infinite for those that miss it; 0 from inside.
        """
        p_OC = self._turned((p_WC - self.p_WO)[None])[0]
        return self._ray_lengths(p_OC, self._turned(directions_W))

    @abstractmethod
    def _distance(self, p_OQ: Array) -> Array: ...

    @abstractmethod
    def _ray_lengths(self, p_OC: Array, directions_O: Array) -> Array: ...

    def _turned(self, vectors_W: Array) -> Array:
        """Return vectors (n, 3) along the shape's axes."""
        # Not by @: a product of this shape starts threads, which cost more.
        turned: Array = np.einsum("ni,ij->nj", vectors_W, self.R_WO)
        return turned

    def _placed(self, p_OQ: Array) -> Array:
        return np.asarray(p_OQ @ self.R_WO.T + self.p_WO)


@dataclass(frozen=True, kw_only=True, eq=False)
class Box(Shape):
    """A box of a ``size`` (3,) [m] along its axes."""

    size: Array

    @property
    def half_extents(self) -> Array:
        """Half of its size (3,) [m]."""
        return 0.5 * self.size

    @property
    def outer_radius(self) -> float:
        """Radius [m] of the sphere through its corners."""
        return 0.5 * float(np.linalg.norm(self.size))

    @property
    def area(self) -> float:
        """Area of its six faces [m^2]."""
        a, b, c = self.size.tolist()
        return float(2.0 * (a * b + b * c + c * a))

    def surface_points(self, spacing: float) -> Array:
        """Return points (n, 3) [m] on its six faces, edges and corners included."""
        a, b, c = (_steps(length, spacing) for length in self.size)
        ends_x, ends_y, ends_z = (np.array([-h, h]) for h in self.half_extents)
        faces = [_grid(ends_x, b, c), _grid(a, ends_y, c), _grid(a, b, ends_z)]
        return self._placed(np.unique(np.vstack(faces), axis=0))

    def _distance(self, p_OQ: Array) -> Array:
        beyond = np.abs(p_OQ) - self.half_extents
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))

    def _ray_lengths(self, p_OC: Array, directions_O: Array) -> Array:
        enters, leaves = _slabs(p_OC, directions_O, self.half_extents)
        return _first_meeting(enters.max(axis=1), leaves.min(axis=1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Cylinder(Shape):
    """A cylinder of a ``radius`` and a ``height`` [m] along its own z."""

    radius: float
    height: float

    @property
    def half_extents(self) -> Array:
        """Half of its size (3,) [m]."""
        return np.array([self.radius, self.radius, 0.5 * self.height])

    @property
    def outer_radius(self) -> float:
        """Radius [m] of the sphere through its rims."""
        return math.hypot(self.radius, 0.5 * self.height)

    @property
    def area(self) -> float:
        """Area of its wall and its two ends [m^2]."""
        return 2.0 * math.pi * self.radius * (self.radius + self.height)

    def surface_points(self, spacing: float) -> Array:
        """Return points (n, 3) [m] on its wall and its two ends, rims included."""
        heights = _steps(self.height, spacing)
        wall = _crossed(_circle(self.radius, spacing), heights)
        radii = _steps(2.0 * self.radius, spacing)
        discs = [_circle(radius, spacing) for radius in radii[(radii >= 0.0)][:-1]]
        ends = _crossed(np.vstack([np.zeros((1, 2)), *discs]), heights[[0, -1]])
        return self._placed(np.vstack((wall, ends)))

    def _distance(self, p_OQ: Array) -> Array:
        across = np.hypot(p_OQ[:, 0], p_OQ[:, 1]) - self.radius
        along = np.abs(p_OQ[:, 2]) - 0.5 * self.height
        outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(across, along), 0.0))

    def _ray_lengths(self, p_OC: Array, directions_O: Array) -> Array:
        across, at = directions_O[:, :2], p_OC[:2]
        enters, leaves = _through_round(at, across, self.radius)
        from_end, to_end = _slabs(p_OC[2:], directions_O[:, 2:], np.array([0.5 * self.height]))
        return _first_meeting(np.maximum(enters, from_end[:, 0]), np.minimum(leaves, to_end[:, 0]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Sphere(Shape):
    """A sphere of a ``radius`` [m]."""

    radius: float

    @property
    def half_extents(self) -> Array:
        """Half of its size (3,) [m]."""
        return np.full(3, self.radius)

    @property
    def outer_radius(self) -> float:
        """Its radius [m]."""
        return self.radius

    @property
    def area(self) -> float:
        """Area of its surface [m^2]."""
        return 4.0 * math.pi * self.radius**2

    def surface_points(self, spacing: float) -> Array:
        """Return points (n, 3) [m] on circles of latitude."""
        count = max(math.ceil(math.pi * self.radius / spacing), 2)
        rings = []
        for latitude in np.linspace(-0.5 * math.pi, 0.5 * math.pi, count + 1):
            circle = _circle(self.radius * math.cos(latitude), spacing)
            rings.append(_crossed(circle, np.array([self.radius * math.sin(latitude)])))
        return self._placed(np.vstack(rings))

    def _distance(self, p_OQ: Array) -> Array:
        return np.asarray(np.linalg.norm(p_OQ, axis=1) - self.radius)

    def _ray_lengths(self, p_OC: Array, directions_O: Array) -> Array:
        return _first_meeting(*_through_round(p_OC, directions_O, self.radius))


def rotation_about_z(yaw: float) -> Array:
    """Return the rotation (3, 3) by an angle about the vertical."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _steps(length: float, spacing: float) -> Array:
    """Return places from one end to the other of a length about 0, no further apart."""
    half = 0.5 * length
    return np.linspace(-half, half, max(math.ceil(length / spacing), 1) + 1)


def _grid(x: Array, y: Array, z: Array) -> Array:
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)


def _circle(radius: float, spacing: float) -> Array:
    """Return points (n, 2) round the centre, one where the radius is 0."""
    count = math.ceil(2.0 * math.pi * radius / spacing)
    if count < 2:
        return np.zeros((1, 2))
    turn = np.linspace(0.0, 2.0 * math.pi, max(count, 6), endpoint=False)
    return radius * np.column_stack((np.cos(turn), np.sin(turn)))


def _crossed(places: Array, heights: Array) -> Array:
    """Return every place (n, 2) at every height (m,) as points (n m, 3)."""
    across = np.tile(places, (len(heights), 1))
    return np.column_stack((across, np.repeat(heights, len(places))))


def _slabs(p: Array, directions: Array, half: Array) -> tuple[Array, Array]:
    """Return where rays enter and leave the slab -half < x < half of each axis (n, k)."""
    steep = np.where(np.abs(directions) < _TINY, np.copysign(_TINY, directions), directions)
    first, second = (-half - p) / steep, (half - p) / steep
    return np.minimum(first, second), np.maximum(first, second)


def _through_round(p: Array, directions: Array, radius: float) -> tuple[Array, Array]:
    """Return where rays enter and leave a circle or sphere about 0; those that miss never do."""
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

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles and the flight volume: positions, and distances to their surfaces.

A shape has a frame O at its centre, with ``p_WO``, ``R_WO`` and a constant velocity ``v_WO_W``.
Distances are negative inside. The formulas are exact signed distance functions (Quilez, distance
functions).
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from quad_mpc_ros.control.lie import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape(ABC):
    """Base class of all shapes.

    Attributes:
        p_WO: Centre (3,) [m] at time 0.
        R_WO: Attitude (3, 3).
        v_WO_W: Constant velocity (3,) [m/s].
        appears_at: Time from which the shape exists [s].
    """

    p_WO: Array
    R_WO: Array = field(default_factory=lambda: np.eye(3))
    v_WO_W: Array = field(default_factory=lambda: np.zeros(3))
    appears_at: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether the shape has a velocity."""
        return bool(np.any(self.v_WO_W))

    @property
    @abstractmethod
    def half_extents(self) -> Array:
        """Half of the shape's size (3,) [m] along its axes."""

    @property
    @abstractmethod
    def outer_radius(self) -> float:
        """Radius [m] of the bounding sphere about the centre."""

    def after(self, seconds: float) -> Shape:
        """Return the shape at a time [s]; before its appearance it does not move."""
        moved = max(seconds - self.appears_at, 0.0)
        if not self.moves or moved == 0.0:
            return self
        return dataclasses.replace(self, p_WO=self.p_WO + moved * self.v_WO_W)

    def distance(self, p_WQ: Array) -> Array:
        """Return the signed distances (n,) [m] of points (n, 3) [m] to the surface."""
        return self._distance(self.turned(p_WQ - self.p_WO))

    @abstractmethod
    def _distance(self, p_OQ: Array) -> Array: ...

    def turned(self, vectors_W: Array) -> Array:
        """Return vectors (n, 3) along the shape's axes."""
        # einsum, because a matrix product of this shape starts threads, which cost more.
        turned: Array = np.einsum("ni,ij->nj", vectors_W, self.R_WO)
        return turned


@dataclass(frozen=True, kw_only=True, eq=False)
class Box(Shape):
    """A box of a ``size`` (3,) [m] along its axes."""

    size: Array

    @property
    def half_extents(self) -> Array:
        """Half of the size (3,) [m]."""
        return 0.5 * self.size

    @property
    def outer_radius(self) -> float:
        """Radius [m] of the sphere through the corners."""
        return 0.5 * float(np.linalg.norm(self.size))

    def _distance(self, p_OQ: Array) -> Array:
        beyond = np.abs(p_OQ) - self.half_extents
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Cylinder(Shape):
    """A cylinder with a ``radius`` and a ``height`` [m] along its z axis."""

    radius: float
    height: float

    @property
    def half_extents(self) -> Array:
        """Half of the size (3,) [m]."""
        return np.array([self.radius, self.radius, 0.5 * self.height])

    @property
    def outer_radius(self) -> float:
        """Radius [m] of the sphere through the rims."""
        return math.hypot(self.radius, 0.5 * self.height)

    def _distance(self, p_OQ: Array) -> Array:
        across = np.hypot(p_OQ[:, 0], p_OQ[:, 1]) - self.radius
        along = np.abs(p_OQ[:, 2]) - 0.5 * self.height
        outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(across, along), 0.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Sphere(Shape):
    """A sphere of a ``radius`` [m]."""

    radius: float

    @property
    def half_extents(self) -> Array:
        """Half of the size (3,) [m]."""
        return np.full(3, self.radius)

    @property
    def outer_radius(self) -> float:
        """Radius [m]."""
        return self.radius

    def _distance(self, p_OQ: Array) -> Array:
        return np.asarray(np.linalg.norm(p_OQ, axis=1) - self.radius)


@dataclass(frozen=True, kw_only=True, eq=False)
class Volume:
    """The flight volume, a box with corners ``minimum`` and ``maximum`` (3,) [m]."""

    minimum: Array
    maximum: Array

    def distance(self, p_WQ: Array) -> Array:
        """Return the distances (n,) [m] of points (n, 3) [m] to the walls; negative outside."""
        return np.asarray(np.minimum(p_WQ - self.minimum, self.maximum - p_WQ).min(axis=1))


class Scene:
    """Shapes over time [s], and the flight volume, if any."""

    def __init__(self, shapes: Sequence[Shape] = (), volume: Volume | None = None) -> None:
        self.shapes = tuple(shapes)
        self.volume = volume
        self._p_WO = _rows([shape.p_WO for shape in shapes])
        self._v_WO_W = _rows([shape.v_WO_W for shape in shapes])
        self._appears_at = np.array([shape.appears_at for shape in shapes])
        self._radii = np.array([shape.outer_radius for shape in shapes])

    @property
    def static(self) -> Scene:
        """The scene with the shapes that exist from the start and do not move."""
        still = [s for s in self.shapes if not s.moves and s.appears_at <= 0.0]
        return Scene(still, self.volume)

    @property
    def changes(self) -> bool:
        """Whether a shape moves or appears after the start."""
        return len(self.static.shapes) < len(self.shapes)

    def there(self, seconds: float) -> list[Shape]:
        """Return the shapes that exist at a time, at their positions at that time."""
        present = np.flatnonzero(self._appears_at <= seconds)
        return [self.shapes[place].after(seconds) for place in present]

    def near(self, p_WC: Array, distance: float, seconds: float) -> list[Shape]:
        """Return shapes whose surface may be within a distance [m] of a point (3,) [m]."""
        moved = np.maximum(seconds - self._appears_at, 0.0)[:, None] * self._v_WO_W
        gaps = np.linalg.norm(self._p_WO + moved - p_WC, axis=1) - self._radii
        near = np.flatnonzero((self._appears_at <= seconds) & (gaps <= distance))
        return [self.shapes[place].after(seconds) for place in near]

    def clearances(self, p_WQ: Array, seconds: Array) -> Array:
        """Return the signed distance (n,) [m] of each point (n, 3) [m] at its time (n,)."""
        nearest = np.full(len(p_WQ), np.inf)
        for shape in self.shapes:
            moved = np.maximum(seconds - shape.appears_at, 0.0)[:, None] * shape.v_WO_W
            away = shape.distance(p_WQ - moved)
            nearest = np.minimum(nearest, np.where(seconds >= shape.appears_at, away, np.inf))
        return nearest


def _rows(vectors: Sequence[Array]) -> Array:
    return np.array(vectors, dtype=np.float64).reshape(-1, 3)

"""Obstacles and the flight volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.shapes import Shape


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

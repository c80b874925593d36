# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a box in the world, such as a fence."""

from __future__ import annotations

import math
from dataclasses import dataclass

from quad_mpc_ros.configuration.errors import ConfigurationError
from quad_mpc_ros.configuration.fields import Configuration, parameter

FARTHEST = 1e7
"""Largest coordinate [m]; UTM coordinates are smaller."""

NO_WALL = (-FARTHEST,) * 3, (FARTHEST,) * 3


@dataclass(frozen=True, kw_only=True)
class BoxParameters(Configuration):
    """The corners of a box; by default it has no walls."""

    minimum: tuple[float, ...] = parameter(
        NO_WALL[0],
        doc="Lowest position inside the fence, usually the mpc's fence; -1e7 is no wall.",
        unit="m",
        length=3,
        minimum=-FARTHEST,
        maximum=FARTHEST,
    )
    maximum: tuple[float, ...] = parameter(
        NO_WALL[1],
        doc="Highest position inside the fence; 1e7 is no wall.",
        unit="m",
        length=3,
        minimum=-FARTHEST,
        maximum=FARTHEST,
    )

    def check(self) -> None:
        """Reject a box without interior."""
        if not all(low < high for low, high in zip(self.minimum, self.maximum, strict=True)):
            raise ConfigurationError(
                f"{self.owner}.minimum",
                self.minimum,
                f"3 numbers below fence.maximum {list(self.maximum)}",
            )

    @property
    def walls(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lowest and highest positions (3,) [m]; infinite where there is no wall."""
        return (
            tuple(-math.inf if low <= -FARTHEST else low for low in self.minimum),
            tuple(math.inf if high >= FARTHEST else high for high in self.maximum),
        )

    @property
    def has_walls(self) -> bool:
        """Whether the box has any wall."""
        return any(map(math.isfinite, (*self.walls[0], *self.walls[1])))

    @property
    def is_closed(self) -> bool:
        """Whether the box has all six walls."""
        return all(map(math.isfinite, (*self.walls[0], *self.walls[1])))

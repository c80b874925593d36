"""Which local map is in force: made in the control step, or before it in another thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.obstacles.local_map import LocalMap

_MOVED = 1.0  # m, after which the surroundings are others
_OUTSIDE = 2.0  # m, after which no tick goes on with the map of before


class Standing(Protocol):
    """Points of what stands, in the frame of the odometry."""

    @property
    def revision(self) -> int:
        """A number that changes when what :meth:`points` returns may have changed."""
        ...

    def points(self, stamp_ns: int, *, near: Array, radius: float) -> Array:
        """Return points (n, 3) [m] of what stands, those within a ``radius`` of a place ``near``.

        Some further away do no harm, and neither do many: they are thinned out.
        """
        ...


class _MapRequest(NamedTuple):
    """Where (3,) and when a map was asked for last, and how wide."""

    p_W: Array
    stamp_ns: int
    radius: float
    far: float


class LocalMapProvider:
    """Has a :class:`.local_map.LocalMap` of what stands around the vehicle.

    A map serves while what is known and asked for stays the same and the vehicle has not moved by
    a metre. Then
    the next one is made where it is asked for; or, with a ``wake``, by the thread that calls
    :meth:`renew` after it was called, while ticks go on with the map of before: up to two metres,
    and for as long as one takes to make. There the grid is made too, if ways are searched.
    """

    def __init__(self, standing: Standing) -> None:
        self._standing = standing
        self._here: LocalMap | None = None
        self._oldest = standing.revision  # maps of earlier ones are in other coordinates
        self._asked: _MapRequest | None = None
        self.wake: Callable[[], None] | None = None
        """Called, in the tick, when another map is due."""

    def at(self, p_W: Array, stamp_ns: int, *, radius: float, far: float) -> LocalMap:
        """Return the map about a place (3,) [m] within a ``radius`` [m].

        To be further than ``far`` [m] from a point makes no difference to who asks.
        """
        here, asked = self._here, _MapRequest(p_W.copy(), stamp_ns, radius, far)
        self._asked = asked
        if here is not None and here.revision >= self._oldest:
            if self._serves(here, asked):
                return here
            if self.wake is not None and here.far >= far and _moved(here, p_W) < _OUTSIDE:
                self.wake()
                return here
        return self._made(asked)

    def renew(self) -> None:
        """Make the next map, if one is due."""
        here, asked = self._here, self._asked
        if asked is not None and (here is None or not self._serves(here, asked)):
            self._made(asked, with_grid=here is not None and here.is_searched)

    def forget(self) -> None:
        """Forget the map: places have other coordinates from this revision of what is known on.

        One that another thread makes meanwhile, by an earlier revision, is not used.
        """
        self._here, self._oldest = None, self._standing.revision

    def _serves(self, here: LocalMap, asked: _MapRequest) -> bool:
        return (
            here.revision == self._standing.revision
            and here.radius == asked.radius
            and here.far >= asked.far
            and _moved(here, asked.p_W) < _MOVED
        )

    def _made(self, asked: _MapRequest, *, with_grid: bool = False) -> LocalMap:
        revision = self._standing.revision
        points = self._standing.points(asked.stamp_ns, near=asked.p_W, radius=asked.radius)
        made = LocalMap(
            points, centre=asked.p_W, radius=asked.radius, far=asked.far, revision=revision
        )
        if with_grid:
            made.make_grid()
        self._here = made
        return made


def _moved(here: LocalMap, p_W: Array) -> float:
    return float(np.linalg.norm(p_W - here.centre))

"""Keeping clear: what is asked of a world, and what comes of it for the controller."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array


class MovingPoints(NamedTuple):
    """Points that move: ``p_W`` (n, 3) [m] at the time asked for, ``v_W`` (n, 3) [m/s].

    ``radius`` (n,) [m] is that of a ball about each, 0 for a point of a surface. ``body`` (n,)
    says which belong to one body, which is passed on one side; ``age`` (n,) [s] is how old what
    was last heard of each is.
    """

    p_W: Array
    v_W: Array
    radius: Array
    body: NDArray[np.int64]
    age: Array

    @staticmethod
    def none() -> MovingPoints:
        """Return no points."""
        empty = np.zeros((0, 3))
        return MovingPoints(empty, empty, np.zeros(0), np.zeros(0, np.int64), np.zeros(0))


class Obstacles(Protocol):
    """What is known of obstacles, in the frame of the odometry.

    Times are stamps in nanoseconds, of the odometry's clock.
    """

    @property
    def revision(self) -> int:
        """A number that changes when what :meth:`points` returns may have changed."""
        ...

    @property
    def spacing(self) -> float:
        """How far points of a surface are apart at most [m]; 0 where they are all there is."""
        ...

    def points(self, stamp_ns: int, *, near: Array, radius: float) -> Array:
        """Return points (n, 3) [m] of what stands, those within a ``radius`` of a place ``near``.

        Some further away do no harm, and neither do many: they are thinned out.
        """
        ...

    def moving(self, stamp_ns: int, *, near: Array, radius: float) -> MovingPoints:
        """Return what moves, where it is predicted to be at a time."""
        ...

    def age(self, stamp_ns: int) -> float:
        """Return how old the newest of what is known of things that stand is [s]; 0 for a map."""
        ...

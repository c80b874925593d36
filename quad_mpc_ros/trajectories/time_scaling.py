"""Uniform time scaling: a path flown slower, and as little slower as the vehicle needs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from quad_mpc_ros.lie import Array
from quad_mpc_ros.trajectories.path import Path, PathSamples

_LARGEST_FACTOR = 50.0
_GROWTH = 1.2
_PRECISION = 1.005

T = TypeVar("T")


class Slowed:
    """A path that takes ``factor`` times as long: uniform time scaling."""

    def __init__(self, path: Path, factor: float) -> None:
        self._path = path
        self._factor = factor

    @property
    def periodic(self) -> bool:
        """As the path."""
        return self._path.periodic

    @property
    def duration(self) -> float:
        """The longer duration [s]."""
        return self._factor * self._path.duration

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]; the n-th derivative shrinks by factor^n."""
        k, found = self._factor, self._path.at(seconds / self._factor)
        return PathSamples(
            p_WB=found.p_WB,
            v_WB_W=found.v_WB_W / k,
            a_WB_W=found.a_WB_W / k**2,
            j_WB_W=found.j_WB_W / k**3,
            yaw=found.yaw,
            yaw_rate=np.asarray(found.yaw_rate) / k,
        )


def quickest(path: Path, flown: Callable[[Path], T | None]) -> T | None:
    """Return what ``flown`` makes of the least slowed path that it makes anything of.

    The factor of time is searched for from 1 upwards, then by bisection to half a percent. None
    when ``flown`` returns None for every factor, up to fifty.
    """
    factor, found = 1.0, flown(Slowed(path, 1.0))
    while found is None:
        factor *= _GROWTH
        if factor > _LARGEST_FACTOR:
            return None
        found = flown(Slowed(path, factor))
    slow, quick = factor, factor / _GROWTH
    while factor > 1.0 and slow > _PRECISION * quick:
        middle = math.sqrt(slow * quick)
        better = flown(Slowed(path, middle))
        if better is None:
            quick = middle
        else:
            slow, found = middle, better
    return found

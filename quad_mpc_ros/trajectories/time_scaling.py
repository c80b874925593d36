"""How much slower a path must be flown for the vehicle to follow it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from quad_mpc_ros.trajectories.path import Path, Slowed

_LARGEST_FACTOR = 50.0
_GROWTH = 1.2
_PRECISION = 1.005

T = TypeVar("T")


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

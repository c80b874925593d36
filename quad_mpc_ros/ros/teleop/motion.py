"""What is asked for by hand, whatever it is asked with."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.lie import Array

REQUESTS = ("takeoff", "start", "hold", "land")
"""The services of the reference node."""


class Motion(NamedTuple):
    """Shares in [-1, 1] of the highest velocities and of the highest yaw rate."""

    forward: float = 0.0
    left: float = 0.0
    up: float = 0.0
    yaw: float = 0.0


STILL = Motion()


class Latch:
    """Lets no motion through after a request until there was none once.

    A stick that is still pushed, or a key that is repeated, would end a hold at once.
    """

    def __init__(self) -> None:
        self._closed = False

    def close(self) -> None:
        """Let no motion through for now."""
        self._closed = True

    def passed(self, motion: Motion) -> Motion:
        """Return the motion, or none."""
        self._closed = self._closed and motion != STILL
        return STILL if self._closed else motion


class Steps:
    """Turns motions into steps: one when a motion begins, and one each period while it lasts."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._since = -math.inf
        self._direction = STILL

    def step(self, motion: Motion, *, now: float) -> Motion | None:
        """Return the step of a motion at a time [s], of shares -1, 0 and 1, or None."""
        direction = Motion(*(float(round(share)) for share in motion))
        before, self._direction = self._direction, direction
        if direction == STILL or (direction == before and now - self._since < self._period):
            return None
        self._since = now
        return direction


def stepped(
    p_WB: Array, yaw: float, step: Motion, *, length: float, turn: float
) -> tuple[Array, float]:
    """Return the place (3,) [m] and yaw [rad] a step of a length [m] and turn [rad] away."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    way = (cos * step.forward - sin * step.left, sin * step.forward + cos * step.left, step.up)
    return p_WB + length * np.array(way), math.remainder(yaw + turn * step.yaw, math.tau)

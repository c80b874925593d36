# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Selection of the points where the reference is left and rejoined around an obstacle.

A straight reference is left at once and rejoined at the end of the known part. At a bend, this
would cut the corner: the reference is left where a nearly straight segment past the obstacle
begins, and rejoined at the end of that segment, or later if the vehicle cannot arrive in time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import ReferenceWindow

_SPACING = 0.1  # m, between points beyond the end of the window
_EXTRAPOLATED = 2.0  # m, length of the straight extrapolation
REST_SPEED = 0.1
"""A slower reference is at rest [m/s]."""
# Distance of the ends of a nearly straight segment, over its length.
_MIN_STRAIGHTNESS = 0.9


class Preview(NamedTuple):
    """The reference from now on, extrapolated linearly beyond the end of its window.

    Positions ``p_W`` (n, 3) [m], velocities ``v_W`` (n, 3) [m/s] and ``times`` (n,) [s] from now;
    the first ``known`` are in the window. ``acceleration`` [m/s^2] is the largest.
    """

    p_W: Array
    v_W: Array
    times: Array
    known: int
    acceleration: float

    @staticmethod
    def of(window: ReferenceWindow, start_ns: int) -> Preview:
        """Return the preview of a window from a time on, extrapolated from a moving end."""
        times = np.asarray(1e-9 * (window.offset_ns + (window.stamp_ns - start_ns)), float)
        first = min(max(int(np.searchsorted(times, 0.0, side="right")) - 1, 0), len(times) - 1)
        p_W, v_W = window.p_WB[first:].copy(), window.v_WB_W[first:].copy()
        now = np.zeros(1)
        p_W[0] = interpolated(now, times, window.p_WB)[0]
        v_W[0] = interpolated(now, times, window.v_WB_W)[0]
        times = np.maximum(times[first:], 0.0)
        known, v, speed = len(times), v_W[-1], float(np.linalg.norm(v_W[-1]))
        if speed > REST_SPEED and len(window.p_WB) > 2:
            further = np.linspace(_SPACING, _EXTRAPOLATED, round(_EXTRAPOLATED / _SPACING)) / speed
            p_W = np.vstack([p_W, p_W[-1] + further[:, None] * v])
            v_W = np.vstack([v_W, np.tile(v, (len(further), 1))])
            times = np.concatenate((times, times[-1] + further))
        hardest = float(np.linalg.norm(window.a_WB_W[first:], axis=1).max(initial=0.0))
        return Preview(p_W, v_W, times, known, hardest)

    @property
    def speeds(self) -> Array:
        """Speeds (n,) [m/s]."""
        return np.asarray(np.linalg.norm(self.v_W, axis=1))

    def part(self, begin: int, end: int) -> Preview:
        """Return the samples in a range."""
        piece = slice(begin, end)
        known = max(min(self.known, end) - begin, 0)
        p_W, v_W, times = self.p_W[piece], self.v_W[piece], self.times[piece]
        return Preview(p_W, v_W, times, known, self.acceleration)

    def at(self, times: Array) -> tuple[Array, Array]:
        """Return positions and velocities (k, 3) at times (k,) [s]."""
        return (
            interpolated(times, self.times, self.p_W),
            interpolated(times, self.times, self.v_W),
        )


class Bypass(NamedTuple):
    """Indices of the samples where the reference is left (0: at once) and rejoined."""

    leave: int
    rejoin: int


def find_bypass(
    ahead: Preview,
    clear: NDArray[np.bool_],
    near: NDArray[np.bool_],
    *,
    speed_max: float,
    astray: bool,
) -> Bypass | None:
    """Return where to leave and rejoin the reference; None if rejoining is impossible.

    Args:
        ahead: The reference.
        clear: Whether the reference's positions (n,) are free of obstacles.
        near: Whether the reference's positions (n,) are within range.
        speed_max: Speed limit of paths [m/s], unless the reference is faster at their end.
        astray: Whether the vehicle has already left the reference.
    """
    good, blocked = np.flatnonzero(clear & near), np.flatnonzero(~clear)
    first = int(blocked[0]) if len(blocked) else -1
    after = good[good > first]
    if len(after) == 0:  # stop before the obstacle until the reference behind it is known
        return Bypass(0, int(good[-1])) if len(good) else None
    beyond = after[after >= ahead.known - 1]
    after = after[: len(after) - len(beyond) + 1]
    along = lengths_along(ahead.p_W)
    leave = 0
    if not astray and first > 1:
        before = np.arange(first)
        leads = _nearly_straight(ahead.p_W, along, before, after[:1])
        leave = int(before[leads][0]) if leads.any() else first - 1
    straight = after[_nearly_straight(ahead.p_W, along, np.array([leave]), after)]
    wanted = after[after >= (straight[-1] if len(straight) else after[0])]
    apart = np.linalg.norm(ahead.p_W[wanted] - ahead.p_W[leave], axis=1)
    fastest = np.maximum(ahead.speeds[wanted], speed_max)
    in_time = wanted[apart <= fastest * (ahead.times[wanted] - ahead.times[leave])]
    return Bypass(leave, int(in_time[0] if len(in_time) else after[-1]))


def interpolated(times: Array, at: NDArray[Any], places: Array) -> Array:
    """Return positions (n, 3) at times (n,), interpolated between given positions."""
    return np.column_stack([np.interp(times, at, places[:, k]) for k in range(3)])


def lengths_along(places: Array) -> Array:
    """Return the length of a path (n, 3) from its start to each of its points (n,)."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))


def is_nearly_straight(p_W: Array) -> bool:
    """Return whether positions (n, 3) are nearly on a straight line."""
    length = np.linalg.norm(np.diff(p_W, axis=0), axis=1).sum()
    return bool(np.linalg.norm(p_W[-1] - p_W[0]) >= _MIN_STRAIGHTNESS * length - 1e-9)


def _nearly_straight(
    p_W: Array, along: Array, starts: NDArray[np.intp], ends: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Return which segments between points (one start or one end) are nearly straight."""
    apart = np.linalg.norm(p_W[ends] - p_W[starts], axis=1)
    return np.asarray(apart >= _MIN_STRAIGHTNESS * (along[ends] - along[starts]) - 1e-9)

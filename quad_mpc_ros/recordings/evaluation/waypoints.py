# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Waypoints in a reference: positions that are held for a while and left by a jump."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.recordings.flight import Flight

# A smooth reference that is published without preview also moves in steps, but of one odometry
# or a few; and one that starts from rest leaves by millimetres.
_MIN_HOLD_TIME = 0.2  # s
_MIN_JUMP = 0.01  # m
_POSITION_TOLERANCE = 1e-6  # m


@dataclass(frozen=True, kw_only=True, eq=False)
class Waypoint:
    """A position ``p_WB`` (3,) [m] that the reference held up to the odometry ``last``.

    ``duration`` [s] is the time for which it was held.
    ``complete``: the waypoint was left by a jump, or the flight ended after it had been held as
    long as the longest waypoint.
    """

    p_WB: Array
    last: int
    duration: float
    complete: bool


def waypoints(flight: Flight) -> list[Waypoint]:
    """Return the waypoints of a flight in order; none if the reference keeps moving."""
    if flight.reference is None:
        return []
    p_WB = flight.reference.p_WB
    steps = np.linalg.norm(np.diff(p_WB, axis=0), axis=1)
    holds = _holds(flight, steps)
    left = [last for last, _ in holds if last < len(steps) and steps[last] > _MIN_JUMP]
    dwell = max((duration for last, duration in holds if last in left), default=np.inf)
    # A jump is seen up to a period late: a hold may look longer by one and the last one shorter.
    enough = dwell - 2.5 * flight.odometry_period
    return [
        Waypoint(
            p_WB=p_WB[last],
            last=last,
            duration=duration,
            complete=last in left or (last == len(steps) and duration >= enough),
        )
        for last, duration in holds
    ]


def waypoint_positions(flight: Flight) -> Array:
    """Return the distinct positions (n, 3) [m] of the waypoints."""
    places = dict.fromkeys(tuple(waypoint.p_WB.tolist()) for waypoint in waypoints(flight))
    return np.reshape(list(places), (-1, 3))


def _holds(flight: Flight, steps: Array) -> list[tuple[int, float]]:
    """Return the last odometry and the duration [s] of each hold, from odometry steps."""
    lasts = [*np.flatnonzero(steps > _POSITION_TOLERANCE).tolist(), len(steps)]
    # The last odometry of a hold stands for the time up to the next one.
    ends = np.append(flight.time[1:], flight.time[-1] + flight.odometry_period)[lasts]
    durations = np.diff(ends, prepend=0.0).tolist()
    pairs = zip(lasts, durations, strict=True)
    return [(last, duration) for last, duration in pairs if duration > _MIN_HOLD_TIME]

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Crash detection.

A false crash would cut the motors of a flying vehicle. So a vehicle counts as crashed only if it
holds its height although in the air it would accelerate

- downwards by at least g - gust, if upside down, where any thrust points down;
- upwards by at least (l / 2 - 1) g - gust, after a collision, with l times its weight as thrust,
  even if the true thrust is half of the modelled.

A collision is a deceleration that no vehicle in the air can reach. The crash ends if the vehicle
falls, for example after it was held.
"""

from __future__ import annotations

from quad_mpc_ros.control.estimation.ground_motion import VehicleMotion
from quad_mpc_ros.control.estimation.kept_height import GUST, SETTLING, THRUST_ERROR, KeptHeight

SLOW = 1.0
"""Filtered speed [m/s] below which the vehicle may have come to rest."""
FAST = 3.0
"""Filtered speed [m/s] above which the vehicle is certainly not on the ground."""
_STOPPED_TIME = 1.0  # s, shortest rest after a collision, when filtered thrust is old
_COLLISION_DECELERATION = 200.0  # m/s^2, between two odometries
_COLLISION_MEMORY_NS = 5_000_000_000


class CrashDetector:
    """Detects crashes from the filtered motion of the vehicle."""

    def __init__(self, gravity: float) -> None:
        self.found = False
        """Whether the vehicle has crashed."""
        self._gravity = gravity
        self.reset()

    def reset(self) -> None:
        """Reset the motion; keep the crash state."""
        self._inverted, self._stopped = KeptHeight(2.0 * SETTLING), KeptHeight(_STOPPED_TIME)
        self._previous = 0, 0.0  # stamp, speed [m/s]
        self._collided_ns: int | None = None

    def update(self, stamp_ns: int, motion: VehicleMotion) -> bool:
        """Take the motion at a stamp; return whether the vehicle has crashed."""
        before_ns, before = self._previous
        stopped, self._previous = before - motion.reported_speed, (stamp_ns, motion.reported_speed)
        if stopped > _COLLISION_DECELERATION * 1e-9 * (stamp_ns - before_ns):
            self._collided_ns = stamp_ns
        elif self._collided_ns is not None and stamp_ns - self._collided_ns > _COLLISION_MEMORY_NS:
            self._collided_ns = None
        if self.found:
            self.found = motion.climb >= -FAST
            if not self.found:
                self.reset()
            return self.found
        fall = rise = 0.0
        if motion.speed < SLOW:
            if motion.up < 0.0:
                fall = (1.0 - GUST) * self._gravity
            if self._collided_ns is not None:
                rise = ((1.0 - THRUST_ERROR) * motion.lift - 1.0 - GUST) * self._gravity
        inverted = self._inverted.lasts(stamp_ns, motion.height, fall)
        self.found = self._stopped.lasts(stamp_ns, motion.height, rise) or inverted
        return self.found

"""Has the vehicle crashed? It lies where it cannot fly from, while the MPC tries to follow.

To say so wrongly would cut the motors of a flying vehicle. So it is said only of what keeps its
height although in the air it could not, with an acceleration a that is

- upside down, where any thrust pushes down: at least g - gust downwards;
- after a collision, with l times its weight as thrust: at least (l / 2 - 1) g - gust upwards,
  even if the true thrust is half of the modelled.

The reference is not asked. A collision is a speed that falls faster than any vehicle in the air
can brake. It is over when the vehicle falls, as one that was held or hung and is let go.
"""

from __future__ import annotations

from quad_mpc_ros.control.estimation.ground_motion import VehicleMotion
from quad_mpc_ros.control.estimation.kept_height import GUST, SETTLING, THRUST_ERROR, KeptHeight

SLOW = 1.0
"""Speed [m/s], filtered, with no more than which it may have come to rest."""
FAST = 3.0
"""Speed [m/s], filtered, beyond which nothing stands or lies."""
_STOPPED = 1.0  # s, the shortest after a collision, when filtered thrust is old
_HARDEST = 200.0  # m/s^2, between two odometries; and for how long [ns] it may lie after that
_AFTERWARDS_NS = 5_000_000_000


class CrashDetector:
    """Follows a vehicle from odometry to odometry."""

    def __init__(self, gravity: float) -> None:
        self.found = False
        """Whether it is certain that it has crashed."""
        self._gravity = gravity
        self.reset()

    def reset(self) -> None:
        """Forget what was before, but not that it has crashed."""
        self._inverted, self._stopped = KeptHeight(2.0 * SETTLING), KeptHeight(_STOPPED)
        self._before = 0, 0.0  # stamp, and speed [m/s]
        self._collided_ns: int | None = None

    def update(self, stamp_ns: int, motion: VehicleMotion) -> bool:
        """Take the motion at a stamp, and return whether it has crashed."""
        self._look_for_collision(stamp_ns, motion.reported_speed)
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

    def _look_for_collision(self, stamp_ns: int, speed: float) -> None:
        before_ns, before = self._before
        if before - speed > _HARDEST * 1e-9 * (stamp_ns - before_ns):
            self._collided_ns = stamp_ns
        elif self._collided_ns is not None and stamp_ns - self._collided_ns > _AFTERWARDS_NS:
            self._collided_ns = None
        self._before = stamp_ns, speed

"""Has the vehicle crashed? It lies where it cannot fly from, while the MPC tries to follow.

To say so wrongly would cut the motors of a flying vehicle. So it is said only of what keeps its
height although in the air it could not, with an acceleration a that is

- upside down, where any thrust pushes down: at least g - gust downwards;
- after a collision, with l times its weight as thrust: at least (l / 2 - 1) g - gust upwards,
  even if the true thrust is half of the modelled.

Over a time T its height then covers at least a T^2 / 8, at the turning point of a throw, which is
the least. Half of that is the most that one that lies may cover. The reference is not asked. A
collision is a speed that falls faster than any vehicle in the air can brake.

It is over when the vehicle falls, as one that was held or hung and is let go; and when commands
do not act any more, so that somebody may put it upright.
"""

from __future__ import annotations

from quad_mpc_ros.control.estimation.filtered_motion import GRAVITY, Motion
from quad_mpc_ros.control.model.samples import OdometrySample

_GUST = 2.0  # m/s^2 that air may push by
_WEAKEST = 0.5  # true thrust over the modelled
_SLOW = 1.0  # m/s, filtered: faster it does not lie
_FALLING = 3.0  # m/s downwards, filtered: it does not lie any more
_INVERTED, _STOPPED = (0.4, 0.8), (1.0, 2.0)  # s, shortest and longest of the time T
# A collision takes so much more of the speed than such an acceleration between two odometries.
# The vehicle may turn out to have crashed for so long after it.
_HARDEST, _COLLISION, _AFTERWARDS_NS = 100.0, 2.0, 5_000_000_000  # m/s^2, m/s


class Crash:
    """Follows a vehicle from odometry to odometry."""

    def __init__(self) -> None:
        self.found = False
        """Whether it is certain that it has crashed."""
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget what was before, but not that it has crashed."""
        self._inverted, self._stopped = _Lying(*_INVERTED), _Lying(*_STOPPED)
        self._before = 0, 0.0  # stamp, and speed [m/s]
        self._collided_ns: int | None = None

    def update(self, odometry: OdometrySample, motion: Motion, *, height: float) -> bool:
        """Return whether it has crashed; ``motion`` and ``height`` [m] are filtered."""
        self._look_for_collision(odometry)
        if self.found:
            self.found = motion.climb >= -_FALLING
            if not self.found:
                self.begin_anew()
            return self.found
        stamp_ns, fall, rise = odometry.stamp_ns, 0.0, 0.0
        slow = motion.speed < _SLOW
        if slow and odometry.up < 0.0:
            fall = GRAVITY - _GUST
        if slow and self._collided_ns is not None:
            rise = (_WEAKEST * motion.lift - 1.0) * GRAVITY - _GUST
        inverted = self._inverted.lasts(stamp_ns, height, fall)
        self.found = self._stopped.lasts(stamp_ns, height, rise) or inverted
        return self.found

    def _look_for_collision(self, odometry: OdometrySample) -> None:
        stamp_ns, speed = odometry.stamp_ns, odometry.speed
        before_ns, before = self._before
        if before - speed > _COLLISION + _HARDEST * 1e-9 * (stamp_ns - before_ns):
            self._collided_ns = stamp_ns
        elif self._collided_ns is not None and stamp_ns - self._collided_ns > _AFTERWARDS_NS:
            self._collided_ns = None
        self._before = stamp_ns, speed


class _Lying:
    """For how long a vehicle has kept its height although in the air it could not."""

    def __init__(self, shortest: float, longest: float) -> None:
        self._shortest, self._longest = shortest, longest  # s
        self._since_ns: int | None = None
        self._lowest = self._highest = self._least = 0.0

    def lasts(self, stamp_ns: int, height: float, acceleration: float) -> bool:
        """Take a height [m]; return whether it has been kept for long enough.

        ``acceleration`` [m/s^2] is the least that it has in the air, 0 where it may have none.
        """
        if acceleration <= 0.0:
            self._since_ns = None
            return False
        if self._since_ns is None or 1e-9 * (stamp_ns - self._since_ns) > self._longest:
            self._since_ns = stamp_ns
            self._lowest, self._highest, self._least = height, height, acceleration
        self._lowest, self._highest = min(self._lowest, height), max(self._highest, height)
        self._least = min(self._least, acceleration)
        duration = 1e-9 * (stamp_ns - self._since_ns)
        covered = self._highest - self._lowest
        return duration >= self._shortest and covered < 0.5 * self._least * duration**2 / 8.0

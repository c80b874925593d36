"""The time of a node, which goes on steadily although the system's clock is set."""

from __future__ import annotations

import time

from rclpy.clock import Clock


class SteadyTime:
    """Nanoseconds of the node's clock as it was at the start, from then on without jumps.

    Simulated time (``use_sim_time``) is taken as it comes, for it may stand or run slowly.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ahead_ns = int(clock.now().nanoseconds) - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the time now."""
        if self._clock.ros_time_is_active:
            return int(self._clock.now().nanoseconds)
        return time.monotonic_ns() + self._ahead_ns

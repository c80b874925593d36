"""Time that runs on steadily, though the system's clock is set or simulated time stands still."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer


def create_steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Create a timer [s] that neither simulated time nor a clock that is set can disturb."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


class SteadyTime:
    """Nanoseconds of the node's clock as it was at the start, from then on without jumps.

    Simulated time (``use_sim_time``) is taken as it comes: it may stand still or run slowly.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ahead_ns = int(clock.now().nanoseconds) - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the time now."""
        if self._clock.ros_time_is_active:
            return int(self._clock.now().nanoseconds)
        return time.monotonic_ns() + self._ahead_ns

"""Steady time, though the system's clock is set or simulated time stands still."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from quad_mpc_ros.ros.spin import until_the_end


def create_steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Create a timer [s] that neither simulated time nor a clock that is set can disturb."""
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    return node.create_timer(period, until_the_end(node, callback), clock=steady)


class Metronome:
    """Calls back every ``period`` seconds, in its own thread, until stopped.

    Missed beats are skipped.
    """

    def __init__(self, period: float, callback: Callable[[], None]) -> None:
        self._period, self._callback = period, callback
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it, after the call that runs now."""
        self._stopped.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        due = time.monotonic() + self._period
        while not self._stopped.wait(max(due - time.monotonic(), 0.0)):
            self._callback()
            due = max(due + self._period, time.monotonic())


class SteadyTime:
    """Nanoseconds of the node's clock at the start, from then on without jumps.

    Simulated time (``use_sim_time``) is used as it is: it may stand still or run slowly.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ahead_ns = int(clock.now().nanoseconds) - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the time now."""
        if self.is_simulated:
            return int(self._clock.now().nanoseconds)
        return time.monotonic_ns() + self._ahead_ns

    @property
    def is_simulated(self) -> bool:
        """Whether it may run at another rate than steady timers."""
        return bool(self._clock.ros_time_is_active)

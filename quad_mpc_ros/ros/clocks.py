# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Steady timers and steady time, independent of jumps of the system clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from quad_mpc_ros.ros.spin import until_the_end


def create_steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Create a timer with a period [s] on the steady clock."""
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    return node.create_timer(period, until_the_end(node, callback), clock=steady)


class Metronome:
    """Calls a function every ``period`` seconds in its own thread, until stopped.

    Missed periods are skipped.
    """

    def __init__(self, period: float, callback: Callable[[], None]) -> None:
        self._period, self._callback = period, callback
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop after the current call."""
        self._stopped.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        due = time.monotonic() + self._period
        while not self._stopped.wait(max(due - time.monotonic(), 0.0)):
            self._callback()
            due = max(due + self._period, time.monotonic())


class SteadyTime:
    """Time of the node's clock at the start, continued without jumps [ns].

    Simulated time (``use_sim_time``) is used unchanged: it may stop or run slowly.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ahead_ns = int(clock.now().nanoseconds) - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the current time."""
        if self.is_simulated:
            return int(self._clock.now().nanoseconds)
        return time.monotonic_ns() + self._ahead_ns

    @property
    def is_simulated(self) -> bool:
        """Whether the time is simulated, and so may differ in rate from steady timers."""
        return bool(self._clock.ros_time_is_active)

"""A topic on its way to the controller in one process, with a fault in between."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from typing import Generic

from quad_mpc_ros.faults.distortions import Distortion, M


class Channel(Generic[M]):
    """Hands messages on at once, or as a distortion says; times in nanoseconds."""

    def __init__(self, distortion: Distortion[M] | None, receive: Callable[[M], None]) -> None:
        self._distortion: Distortion[M] | None = distortion
        self._receive: Callable[[M], None] = receive
        self._before: M | None = None
        self._waiting: list[tuple[int, int, M]] = []
        self._order = itertools.count()
        self.passed_ns = 0
        """When the last message was sent that no fault touched."""

    def send(self, message: M, *, time_ns: int, elapsed_ns: int | None) -> None:
        """Take a message; ``elapsed_ns`` is the time since a fault began, None without one."""
        if self._distortion is None or self._before is None or elapsed_ns is None:
            self._before, self.passed_ns = message, time_ns
            self._wait(message, time_ns)
            return
        for delivery in self._distortion(message, self._before, elapsed_ns):
            self._wait(delivery.message, time_ns + delivery.delay_ns)

    def deliver(self, time_ns: int) -> None:
        """Let arrive what is due."""
        while self._waiting and self._waiting[0][0] <= time_ns:
            self._receive(heapq.heappop(self._waiting)[-1])

    def forget_all_but_last(self) -> None:
        """Keep of what waits the last, as the queue of a topic does for a process that stands."""
        self._waiting = self._waiting and [max(self._waiting)]

    def _wait(self, message: M, arrival_ns: int) -> None:
        heapq.heappush(self._waiting, (arrival_ns, next(self._order), message))

"""Which command acts when, and what rate and throttle the vehicle has by then."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.core.state import Input

_KEPT_NS = 2_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Interval:
    """A stretch of time under one command, ``duration`` in seconds."""

    duration: float
    command: Input


class CommandHistory:
    """The commands actually sent; each acts from ``delay_ns`` after it was sent."""

    def __init__(self, *, delay_ns: int, initial: Input) -> None:
        self._delay_ns = delay_ns
        self._initial = initial
        self._sent: deque[tuple[int, Input]] = deque()

    def record(self, command: Input, *, sent_ns: int) -> None:
        """Remember a command."""
        self._sent.append((sent_ns + self._delay_ns, command))
        while len(self._sent) > 1 and self._sent[1][0] < sent_ns - _KEPT_NS:
            self._sent.popleft()

    def between(self, start_ns: int, end_ns: int) -> Iterator[Interval]:
        """Yield what acts from one time to another, in order."""
        acting, time_ns = self._initial, start_ns
        for acts_ns, command in self._sent:
            if acts_ns >= end_ns:
                break
            if acts_ns > time_ns:
                yield Interval(duration=(acts_ns - time_ns) * 1e-9, command=acting)
                time_ns = acts_ns
            acting = command
        if end_ns > time_ns:
            yield Interval(duration=(end_ns - time_ns) * 1e-9, command=acting)


@dataclass(frozen=True, kw_only=True)
class ActuatorLag:
    """First-order lags of body rate and throttle, time constants in seconds."""

    rate: float
    thrust: float

    def throttle(self, throttle: float, interval: Interval) -> tuple[float, float]:
        """Return the throttle after an interval and its mean over it."""
        decay, share = _decay(interval.duration, self.thrust)
        excess = throttle - interval.command.throttle
        return interval.command.throttle + decay * excess, (
            interval.command.throttle + share * excess
        )

    def body_rate(self, w_WB_B: Array, interval: Interval) -> tuple[Array, Array]:
        """Return the rate after an interval and its mean over it, (3,) each."""
        decay, share = _decay(interval.duration, self.rate)
        command = interval.command.w_WB_B
        excess = w_WB_B - command
        return np.asarray(command + decay * excess), np.asarray(command + share * excess)


def _decay(duration: float, time_constant: float) -> tuple[float, float]:
    """Return exp(-t / tau) at the end of a duration, and its mean over it."""
    if time_constant <= 0.0:
        return 0.0, 0.0
    decay = math.exp(-duration / time_constant)
    return decay, time_constant * (1.0 - decay) / duration

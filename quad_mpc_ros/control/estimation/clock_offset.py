# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The offset between the clock of a source's stamps and the clock of their arrivals."""

from __future__ import annotations

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.stage import Stage

# Least time per drift of two clocks: real ones drift by 1e-4, but a simulation that should run in
# real time can fall behind by 2 %.
_TIME_PER_DRIFT = 50


class ClockOffset:
    """Tracks how far a source's clock is behind the local clock.

    The fastest arrival counts as arriving without latency. The offset decays at the largest rate
    of clock drift.
    """

    def __init__(self, *, until_last: bool = False) -> None:
        """With ``until_last``, keep the duration confirmed by the last arrival."""
        self._until_last = until_last
        self.behind_ns = 0
        self.last_age_ns = 0
        """The latency of the last arrival; negative for the fastest."""
        self._arrived_ns = 0

    def age_ns(self, stamp_ns: int, *, now_ns: int) -> int:
        """Return the latency of a message that arrives now; negative for the fastest message."""
        return now_ns - stamp_ns - self.behind_ns

    def follow(self, stamp_ns: int, *, now_ns: int) -> int:
        """Take an arrival, update the offset, and return the age by the previous offset."""
        drift_ns = (now_ns - self._arrived_ns) // _TIME_PER_DRIFT
        if self._until_last:
            drift_ns = min(max(drift_ns, 0), max(self.last_age_ns, 0))
        self.behind_ns += drift_ns
        age_ns = now_ns - stamp_ns - self.behind_ns
        if age_ns < 0:
            self.behind_ns += age_ns
        self._arrived_ns, self.last_age_ns = now_ns, age_ns
        return age_ns

    def set(self, behind_ns: int, *, stamp_ns: int, now_ns: int) -> None:
        """Set the offset at an arrival."""
        self.behind_ns, self._arrived_ns = behind_ns, now_ns
        self.last_age_ns = self.age_ns(stamp_ns, now_ns=now_ns)


class Lateness(Stage):
    """Sending times by the clock of the stamps, from the lateness of answered odometries.

    The lateness is relative to the fastest odometry, whose latency is part of the input delay.
    Only answered odometries count, as only their arrivals are recorded. A lateness beyond
    ``odom_timeout``, of either sign, means that a clock was set: start again.
    """

    def __init__(self, config: MpcConfig) -> None:
        self._offset: ClockOffset | None = None
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply a changed timeout."""
        self._most_ns = round(config.odom_timeout * 1e9)

    def arrive(self, stamp_ns: int, *, now_ns: int) -> None:
        """Take the arrival of an answered odometry."""
        if self._offset is not None:
            age_ns = self._offset.follow(stamp_ns, now_ns=now_ns)
            if -self._most_ns <= age_ns <= self._most_ns:
                return
        self._offset = ClockOffset()
        self._offset.set(now_ns - stamp_ns, stamp_ns=stamp_ns, now_ns=now_ns)

    def sent_ns(self, now_ns: int) -> int:
        """Return the time by the clock of the stamps."""
        return now_ns if self._offset is None else now_ns - self._offset.behind_ns


class PersistentOffset:
    """Duration of an unexpected offset, to distinguish a set clock from a single bad stamp."""

    def __init__(self) -> None:
        self._since: tuple[int, int] | None = None  # the time, and the offset then

    def clear(self) -> None:
        """Record that the offset is as expected."""
        self._since = None

    def duration_ns(self, offset_ns: int, *, now_ns: int, tolerance_ns: float) -> int:
        """Take an unexpected offset; return how long it has been constant."""
        if self._since is None or abs(offset_ns - self._since[1]) > tolerance_ns:
            self._since = now_ns, offset_ns
        return now_ns - self._since[0]

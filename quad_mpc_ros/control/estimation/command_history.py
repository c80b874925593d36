"""The commands sent, and when each of them acts: after the input delay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import INPUT_SIZE

_KEPT_NS = 2_000_000_000
_INITIAL_CAPACITY = 256  # commands; doubled if they do not suffice


class Acting(NamedTuple):
    """Commands (n, 4) that act one after the other, each for one of the ``durations`` (n,) [s]."""

    durations: Array
    commands: Array


class CommandHistory:
    """The commands actually sent, by the clock of the odometry's stamps.

    Each command acts ``delay_ns`` after it is sent.
    """

    def __init__(self, *, delay_ns: int, initial: Array) -> None:
        """``initial`` (4,) acts before all others."""
        self._delay_ns = delay_ns
        self._initial = initial
        self._times_ns = np.zeros(_INITIAL_CAPACITY, dtype=np.int64)
        self.acts_ns = self._times_ns[:0]
        """Time from which each command acts (n,) [ns], without the first of ``commands``."""
        self.commands = np.zeros((_INITIAL_CAPACITY + 1, INPUT_SIZE))
        """The initial command, n others, and unused rows."""
        self.commands[0] = self._initial

    def record(self, command: Array, *, stamp_ns: int) -> None:
        """Add a command (4,); later ones, from before a clock was set back, are dropped."""
        acts_ns, count = stamp_ns + self._delay_ns, self.acts_ns.size
        while count > 0 and self._times_ns.item(count - 1) > acts_ns:
            count -= 1
        if count == self._times_ns.size:
            count = self._grow(stamp_ns - _KEPT_NS)
        self._times_ns[count] = acts_ns
        self.acts_ns = self._times_ns[: count + 1]
        self.commands[count + 1] = command

    def forget(self) -> None:
        """Drop all commands, which did not act."""
        self.acts_ns = self._times_ns[:0]
        self.commands[0] = self._initial

    def knows(self, time_ns: int) -> bool:
        """Whether the command that acted at a time is known."""
        return self.acts_ns.size > 0 and self.acts_ns.item(0) <= time_ns

    def _grow(self, oldest_ns: int) -> int:
        """Drop commands before a time, and double the capacity if more than half remain.

        Returns how many remain.
        """
        count = len(self._times_ns)
        kept = int(np.searchsorted(self._times_ns, oldest_ns))
        if 2 * kept < count:
            self._times_ns = np.resize(self._times_ns, 2 * count)
            self.commands = np.resize(self.commands, (2 * count + 1, INPUT_SIZE))
        left = count - kept
        # Source and destination overlap, hence copies.
        self._times_ns[:left] = self._times_ns[kept:count].copy()
        self.commands[: left + 1] = self.commands[kept : count + 1].copy()
        return left


@compiled
def acting_between(
    acts_ns: NDArray[np.int64], commands: Array, start_ns: int, end_ns: int
) -> Acting:
    """Return the commands that act between two times, from a history's times (n,) and commands."""
    last = len(acts_ns)  # row of the command that acts at the end
    while last > 0 and acts_ns[last - 1] >= end_ns:
        last -= 1
    first = last
    while first > 0 and acts_ns[first - 1] > start_ns:
        first -= 1
    durations, acting = np.empty(last - first + 1), np.empty((last - first + 1, INPUT_SIZE))
    found = 0
    for row in range(first, last + 1):
        begin = start_ns if row == first else acts_ns[row - 1]
        end = end_ns if row == last else acts_ns[row]
        if end > begin:
            durations[found] = (end - begin) * 1e-9
            acting[found] = commands[row]
            found += 1
    return Acting(durations[:found], acting[:found])

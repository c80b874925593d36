"""The commands sent, and which of them acts when: they act after the delay of the input."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import INPUT_SIZE

_KEPT_NS = 2_000_000_000
_ROOM = 256  # commands to begin with; twice as many when they are too few


class Acting(NamedTuple):
    """What acts over a time: ``commands`` (n, 4), each for one of the ``durations`` (n,) [s]."""

    durations: Array
    commands: Array


class CommandHistory:
    """The commands actually sent.

    Each acts from ``delay_ns`` after it is sent: on the clock of the odometry's stamps, that of
    the odometry that it answers and by how much that came later than usual.
    """

    def __init__(self, *, delay_ns: int, initial: Array) -> None:
        """``initial`` (4,) acts before all others."""
        self._delay_ns = delay_ns
        self._initial = initial
        self._room_ns = np.zeros(_ROOM, dtype=np.int64)
        self.acts_ns = self._room_ns[:0]
        """From when on each command acts (n,), all but the first of ``commands`` [ns]."""
        self.commands = np.zeros((_ROOM + 1, INPUT_SIZE))
        """The commands: one that acts before all others, n others, and room for more."""
        self.commands[0] = self._initial

    def record(self, command: Array, *, stamp_ns: int) -> None:
        """Remember a command (4,); those of a later time, as of a clock set back, are void."""
        acts_ns, count = stamp_ns + self._delay_ns, self.acts_ns.size
        while count > 0 and self._room_ns.item(count - 1) > acts_ns:
            count -= 1
        if count == self._room_ns.size:
            count = self._make_room(stamp_ns - _KEPT_NS)
        self._room_ns[count] = acts_ns
        self.acts_ns = self._room_ns[: count + 1]
        self.commands[count + 1] = command

    def forget(self) -> None:
        """Forget what was sent: it did not act."""
        self.acts_ns = self._room_ns[:0]
        self.commands[0] = self._initial

    def knows(self, time_ns: int) -> bool:
        """Whether what acted at a time was sent from here, as far as is remembered."""
        return self.acts_ns.size > 0 and self.acts_ns.item(0) <= time_ns

    def _make_room(self, oldest_ns: int) -> int:
        """Forget what acted before a time, or grow if that is not even half; return what is left.

        All room is taken.
        """
        count = len(self._room_ns)
        kept = int(np.searchsorted(self._room_ns, oldest_ns))
        if 2 * kept < count:
            self._room_ns = np.resize(self._room_ns, 2 * count)
            self.commands = np.resize(self.commands, (2 * count + 1, INPUT_SIZE))
        left = count - kept
        # From one to another place of the same arrays, hence copies.
        self._room_ns[:left] = self._room_ns[kept:count].copy()
        self.commands[: left + 1] = self.commands[kept : count + 1].copy()
        return left


@compiled
def acting_between(
    acts_ns: NDArray[np.int64], commands: Array, start_ns: int, end_ns: int
) -> Acting:
    """Return what acts between two times, of a history's times (n,) and commands."""
    last = len(acts_ns)  # the row of the command that acts at the end
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

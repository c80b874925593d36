"""The commands sent, and which of them acts when: they act after the delay of the input."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array
from quad_mpc_ros.model.state import INPUT_SIZE, Input

_KEPT_NS = 2_000_000_000
_ROOM = 256  # commands to begin with; twice as many when they are too few


class Acting(NamedTuple):
    """What acts over a time: ``commands`` (n, 4), each for one of the ``durations`` (n,) [s]."""

    durations: Array
    commands: Array


class CommandHistory:
    """The commands actually sent.

    Each acts from ``delay_ns`` after the stamp of the odometry that it answers: counted on one
    clock, whoever's it is, and no matter how old the odometry was when it came.
    """

    def __init__(self, *, delay_ns: int, initial: Input) -> None:
        self._delay_ns = delay_ns
        self._count = 0
        self._acts_ns = np.zeros(_ROOM, dtype=np.int64)
        self._commands = np.zeros((_ROOM + 1, INPUT_SIZE))
        self._initial = initial.vector()
        self._commands[0] = self._initial  # acts before the first one, which is in row 1
        self._found = Acting(np.zeros(_ROOM + 1), np.zeros((_ROOM + 1, INPUT_SIZE)))

    def record(self, command: Input, *, stamp_ns: int) -> None:
        """Remember a command; those of a later time, before a clock was set back, are void."""
        acts_ns = stamp_ns + self._delay_ns
        while self._count > 0 and self._acts_ns[self._count - 1] > acts_ns:
            self._count -= 1
        if self._count == len(self._acts_ns):
            self._make_room(stamp_ns - _KEPT_NS)
        self._acts_ns[self._count] = acts_ns
        self._count += 1
        row = self._commands[self._count]
        row[0], row[1:] = command.throttle, command.w_WB_B

    def forget(self) -> None:
        """Forget what was sent: it did not act."""
        self._count = 0
        self._commands[0] = self._initial

    def knows(self, time_ns: int) -> bool:
        """Whether what acted at a time was sent from here, as far as is remembered."""
        return self._count > 0 and bool(self._acts_ns[0] <= time_ns)

    def between(self, start_ns: int, end_ns: int) -> Acting:
        """Return what acts from one time to another, in order; the next call overwrites it."""
        durations, commands = self._found
        count = _acting_between(
            acts_ns=self._acts_ns,
            commands=self._commands,
            count=self._count,
            start_ns=start_ns,
            end_ns=end_ns,
            durations=durations,
            acting=commands,
        )
        return Acting(durations[:count], commands[:count])

    def _make_room(self, oldest_ns: int) -> None:
        """Forget what acted before a time, or grow if that is not even half of it."""
        kept = int(np.searchsorted(self._acts_ns, oldest_ns))
        if 2 * kept < self._count:
            room = 2 * len(self._acts_ns)
            self._acts_ns = np.resize(self._acts_ns, room)
            self._commands = np.resize(self._commands, (room + 1, INPUT_SIZE))
            self._found = Acting(np.zeros(room + 1), np.zeros((room + 1, INPUT_SIZE)))
        self._count -= kept
        # From one to another place of the same arrays, hence copies.
        self._acts_ns[: self._count] = self._acts_ns[kept : kept + self._count].copy()
        self._commands[: self._count + 1] = self._commands[kept : kept + self._count + 1].copy()


@compiled
def _acting_between(
    acts_ns: NDArray[np.int64],
    commands: Array,
    count: int,
    start_ns: int,
    end_ns: int,
    durations: Array,
    acting: Array,
) -> int:
    """Write what acts between two times and return how many it are.

    The first ``count`` times belong to the ``commands`` but the first, which acts before them.
    """
    last = count  # the row of the command that acts at the end
    while last > 0 and acts_ns[last - 1] >= end_ns:
        last -= 1
    first = last
    while first > 0 and acts_ns[first - 1] > start_ns:
        first -= 1
    found = 0
    for row in range(first, last + 1):
        begin = start_ns if row == first else acts_ns[row - 1]
        end = end_ns if row == last else acts_ns[row]
        if end > begin:
            durations[found] = (end - begin) * 1e-9
            acting[found] = commands[row]
            found += 1
    return found

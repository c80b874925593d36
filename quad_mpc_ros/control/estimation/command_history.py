# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The sent commands; each acts after the input delay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import BODY_RATE, INPUT_SIZE

_CAPACITY = 4096  # commands; half of them last for two seconds at 1 kHz


class Acting(NamedTuple):
    """Successive active commands (n, 4), with their ``durations`` (n,) [s]."""

    durations: Array
    commands: Array


class CommandHistory:
    """The commands actually sent, by the clock of the odometry's stamps.

    Each command acts ``delay_ns`` after it is sent.
    """

    def __init__(self, *, delay_ns: int, initial: Array) -> None:
        """``initial`` (4,) acts before all other commands."""
        self._delay_ns = delay_ns
        self._initial = initial
        self._times_ns = np.zeros(_CAPACITY, dtype=np.int64)
        self.acts_ns = self._times_ns[:0]
        """Time from which each command acts (n,) [ns], without the first of ``commands``."""
        self.commands = np.zeros((_CAPACITY + 1, INPUT_SIZE))
        """The initial command, n further commands, and unused rows."""
        self.commands[0] = self._initial

    def record(self, command: Array, *, stamp_ns: int) -> None:
        """Add a command (4,); drop later commands from before a clock was set back."""
        acts_ns, count = stamp_ns + self._delay_ns, self.acts_ns.size
        while count > 0 and self._times_ns.item(count - 1) > acts_ns:
            count -= 1
        if count == _CAPACITY:
            count = _CAPACITY // 2
            self._times_ns[:count] = self._times_ns[count:]
            self.commands[: count + 1] = self.commands[count:]
        self._times_ns[count] = acts_ns
        self.acts_ns = self._times_ns[: count + 1]
        self.commands[count + 1] = command

    def acts_at(self, stamp_ns: int) -> bool:
        """Whether a sent command acts at a time, and not the initial one."""
        return self.acts_ns.size > 0 and self.acts_ns.item(0) <= stamp_ns

    def assume(self, w_WB_B: Array) -> None:
        """Set the rates (3,) of the initial command: unknown commands hold the measured rates."""
        self.commands[0, BODY_RATE] = w_WB_B

    def forget(self) -> None:
        """Drop all commands, because the vehicle did not execute them."""
        self.acts_ns = self._times_ns[:0]
        self.commands[0] = self._initial


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

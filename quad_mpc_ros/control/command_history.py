"""Which command acts when."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from quad_mpc_ros.core.state import Input

_KEPT_NS = 2_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Interval:
    """A stretch of time under one command, ``duration`` in seconds."""

    duration: float
    command: Input


class CommandHistory:
    """The commands actually sent.

    Each acts from ``delay_ns`` after the stamp of the odometry that it answers: counted on one
    clock, whoever's it is, and no matter how old the odometry was when it came.
    """

    def __init__(self, *, delay_ns: int, initial: Input) -> None:
        self._delay_ns = delay_ns
        self._initial = initial
        self._sent: deque[tuple[int, Input]] = deque()

    def record(self, command: Input, *, stamp_ns: int) -> None:
        """Remember a command; those that would act after it are of a clock that was set back."""
        acts_ns = stamp_ns + self._delay_ns
        while self._sent and self._sent[-1][0] > acts_ns:
            self._sent.pop()
        self._sent.append((acts_ns, command))
        while len(self._sent) > 1 and self._sent[1][0] < stamp_ns - _KEPT_NS:
            self._sent.popleft()

    def forget(self) -> None:
        """Forget what was sent: it did not act."""
        self._sent.clear()

    def knows(self, time_ns: int) -> bool:
        """Whether what acted at a time was sent from here, as far as is remembered."""
        return bool(self._sent) and self._sent[0][0] <= time_ns

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

"""A process that only wakes at a rate: how late is the machine by itself?

It separates ticks that were late because of the controller from stalls of the machine.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Wakes:
    """How often a bare timer woke, and each time that was later than a period.

    ``late`` are pairs: the time of the system clock [ns], and the lateness [ms].
    """

    count: int
    late: list[tuple[int, float]]

    @property
    def latest(self) -> float:
        """The longest lateness [ms] of those; 0 when there is none."""
        return max((lateness for _, lateness in self.late), default=0.0)

    def stalls(self, *, margin: float) -> list[tuple[float, float]]:
        """Return the separate intervals [ns] of stalls, with ``margin`` seconds around each."""
        found: list[tuple[float, float]] = []
        for woken_ns, lateness in sorted(self.late):
            begin, end = woken_ns - 1e6 * lateness - 1e9 * margin, woken_ns + 1e9 * margin
            if found and begin <= found[-1][1]:
                begin, end = min(begin, found[-1][0]), max(end, found[-1][1])
                found.pop()
            found.append((begin, end))
        return found


class BareTimer:
    """Runs such a process from its making until :meth:`stop`."""

    def __init__(self, period: float) -> None:
        command = [sys.executable, "-P", "-m", __name__, str(period)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def stop(self) -> Wakes | None:
        """End it; return its result, or None when it did not answer."""
        try:
            output, _ = self._process.communicate(timeout=5.0)
            return Wakes(**json.loads(output))
        except (subprocess.TimeoutExpired, ValueError):
            self._process.kill()
            return None


def watch_time(period: float, stop: Any) -> Wakes:
    """Wake every ``period`` seconds until the file ``stop`` ends."""
    count: int = 0
    late: list[tuple[int, float]] = []
    due = time.monotonic()
    while True:
        due += period
        ended, _, _ = select.select([stop], [], [], max(due - time.monotonic(), 0.0))
        if ended:
            return Wakes(count=count, late=late)
        lateness = time.monotonic() - due
        count += 1
        if lateness > period:
            late.append((time.time_ns(), 1e3 * lateness))


if __name__ == "__main__":
    result = json.dumps(vars(watch_time(float(sys.argv[1]), sys.stdin)))
    with contextlib.suppress(BrokenPipeError):  # nobody is there to hear it: interrupted
        os.write(sys.stdout.fileno(), result.encode())

"""A process that does nothing but wake at a rate: how late is the machine by itself?

Beside a soak it tells ticks that were late because of the controller from those that anything
would have been late for.
"""

from __future__ import annotations

import json
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Wakes:
    """Times a bare timer woke: how many, how many later than a period, the latest [ms]."""

    count: int
    late: int
    max_ms: float


class BareTimer:
    """Runs such a process from its making until :meth:`stop`."""

    def __init__(self, period: float) -> None:
        command = [sys.executable, "-P", "-m", __name__, str(period)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )

    def stop(self) -> Wakes | None:
        """End it; return what it saw, or None when it did not live to tell."""
        try:
            told, _ = self._process.communicate(timeout=5.0)
            return Wakes(**json.loads(told))
        except (subprocess.TimeoutExpired, ValueError):
            self._process.kill()
            return None


def watch_time(period: float, stop: Any) -> Wakes:
    """Wake every ``period`` seconds until the file ``stop`` ends."""
    count, late, latest = 0, 0, 0.0
    due = time.monotonic()
    while True:
        due += period
        ended, _, _ = select.select([stop], [], [], max(due - time.monotonic(), 0.0))
        if ended:
            return Wakes(count=count, late=late, max_ms=1e3 * latest)
        lateness = time.monotonic() - due
        count += 1
        late += lateness > period
        latest = max(latest, lateness)


if __name__ == "__main__":
    print(json.dumps(vars(watch_time(float(sys.argv[1]), sys.stdin))))

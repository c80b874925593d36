# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Playback of a bag: due times of its messages, and the threads that read ahead and publish.

All times are integers in nanoseconds. *Steady* times are from the clock that drives the playback;
*recorded* times are log times of the bag.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from quad_mpc_ros.recordings.reader import RecordedMessage

T = TypeVar("T")

_S = 1_000_000_000
_READ_AHEAD_MESSAGES = 1000


class Playback:
    """Publishes messages when due, and the recorded time at regular intervals.

    Due times are linear in log times: a late message does not delay later messages.
    """

    def __init__(
        self,
        messages: Iterator[RecordedMessage],
        *,
        recorded_ns: int,
        steady_ns: int,
        rate: float,
        publish: Callable[[RecordedMessage], None],
        publish_clock: Callable[[int], None],
        clock_rate: float,
    ) -> None:
        """Begin at ``steady_ns`` with the recorded time ``recorded_ns``.

        ``publish_clock`` gets the recorded time at ``clock_rate`` [Hz]; 0 disables it.
        """
        self._messages = read_ahead(messages, depth=_READ_AHEAD_MESSAGES)
        self._next = next(self._messages, None)
        self._recorded_ns, self._steady_ns, self._rate = recorded_ns, steady_ns, rate
        self._publish = publish
        self._publish_clock = publish_clock
        self._clock_period_ns = round(_S / clock_rate) if clock_rate else 0
        self._clock_at_ns = 0
        self.count = 0
        """The number of published messages."""
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def finished(self) -> bool:
        """Whether the last message has been published."""
        return self._next is None

    def recorded_ns(self, steady_ns: int) -> int:
        """Return the recorded time at a steady time; before the start it is constant."""
        return self._recorded_ns + round(max(0, steady_ns - self._steady_ns) * self._rate)

    def step(self, steady_ns: int) -> int | None:
        """Publish messages due at a steady time; return the time of the next, None at the end."""
        if self._clock_period_ns and steady_ns >= self._clock_at_ns:
            self._publish_clock(self.recorded_ns(steady_ns))
            missed = (steady_ns - self._clock_at_ns) // self._clock_period_ns
            self._clock_at_ns += (1 + missed) * self._clock_period_ns
        while self._next is not None:
            elapsed_ns = self._next.log_time_ns - self._recorded_ns
            due_ns = self._steady_ns + round(elapsed_ns / self._rate)
            if due_ns > steady_ns:
                return min(due_ns, self._clock_at_ns) if self._clock_period_ns else due_ns
            self._publish(self._next)
            self.count += 1
            self._next = next(self._messages, None)
        return None

    def start(self, *, at_end: Callable[[Exception | None], None]) -> None:
        """Publish in a thread.

        ``at_end`` is called once from the thread, with None after the last message or with the
        error; not when the thread is stopped.
        """
        self._thread = threading.Thread(target=self._run, args=(at_end,), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop publishing and reading, and wait for the end of the threads."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()
        self._messages.close()

    def _run(self, at_end: Callable[[Exception | None], None]) -> None:
        problem: Exception | None = None
        try:
            while (at_ns := self.step(time.monotonic_ns())) is not None:
                if self._stopped.wait(max(0, at_ns - time.monotonic_ns()) / _S):
                    return
        except Exception as error:  # reported by the owner of the thread
            problem = error
        at_end(problem)


def read_ahead(items: Iterator[T], *, depth: int) -> Generator[T, None, None]:
    """Yield items, while another thread reads the next ``depth`` of them.

    So opening a chunk of a bag does not delay messages. An exception of the iteration is raised in
    order.
    """

    def read() -> tuple[list[T], Exception | None]:
        ready: list[T] = []
        try:
            ready.extend(itertools.islice(items, depth))
        except Exception as error:
            return ready, error
        return ready, None

    with ThreadPoolExecutor(max_workers=1) as reader:
        ready, error = read()
        while ready or error is not None:
            following = reader.submit(read)
            yield from ready
            if error is not None:
                raise error
            ready, error = following.result()

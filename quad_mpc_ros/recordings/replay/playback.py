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


class PlaybackTimeline:
    """The recorded time at a steady time.

    The relation is linear from the last start or pause: a late message does not delay later
    messages.
    """

    def __init__(self, *, recorded_ns: int, steady_ns: int, rate: float, paused: bool) -> None:
        self._recorded_ns = recorded_ns
        self._steady_ns = steady_ns
        self._rate = rate
        self.paused = paused

    def recorded_ns(self, steady_ns: int) -> int:
        """Return the recorded time at a steady time; before the start it is constant."""
        if self.paused:
            return self._recorded_ns
        elapsed = max(0, steady_ns - self._steady_ns)
        return self._recorded_ns + round(elapsed * self._rate)

    def steady_ns(self, recorded_ns: int) -> int:
        """Return the steady time at which a recorded time is reached, unless paused."""
        return self._steady_ns + round((recorded_ns - self._recorded_ns) / self._rate)

    def set_paused(self, paused: bool, steady_ns: int) -> None:
        """Pause or resume at a steady time."""
        self._recorded_ns = self.recorded_ns(steady_ns)
        # A pause before the start does not bring the start forward.
        self._steady_ns = max(steady_ns, self._steady_ns)
        self.paused = paused


class Playback:
    """Publishes messages when due, and the recorded time at regular intervals.

    Only waits for messages that are still being read; :meth:`close` ends reading.
    """

    def __init__(
        self,
        messages: Iterator[RecordedMessage],
        *,
        timeline: PlaybackTimeline,
        publish: Callable[[RecordedMessage], None],
        publish_clock: Callable[[int], None],
        clock_rate: float,
    ) -> None:
        """``publish_clock`` gets the recorded time at ``clock_rate`` [Hz]; 0 disables it."""
        self._messages = read_ahead(messages, depth=_READ_AHEAD_MESSAGES)
        self.close = self._messages.close
        self._next = next(self._messages, None)
        self.timeline = timeline
        self._publish = publish
        self._publish_clock = publish_clock
        self._clock_period_ns = round(_S / clock_rate) if clock_rate else 0
        self._clock_at_ns = 0
        self.count = 0
        """The number of published messages."""

    @property
    def finished(self) -> bool:
        """Whether the last message has been published."""
        return self._next is None

    def step(self, steady_ns: int) -> int | None:
        """Publish messages due at a steady time; return the time of the next action.

        None means no action until the timeline resumes, or the end.
        """
        if self._clock_period_ns and steady_ns >= self._clock_at_ns:
            self._publish_clock(self.timeline.recorded_ns(steady_ns))
            missed = (steady_ns - self._clock_at_ns) // self._clock_period_ns
            self._clock_at_ns += (1 + missed) * self._clock_period_ns
        while self._next is not None:
            clock_at_ns = self._clock_at_ns if self._clock_period_ns else None
            if self.timeline.paused:
                return clock_at_ns
            due_ns = self.timeline.steady_ns(self._next.log_time_ns)
            if due_ns > steady_ns:
                return due_ns if clock_at_ns is None else min(due_ns, clock_at_ns)
            self._publish(self._next)
            self.count += 1
            self._next = next(self._messages, None)
        return None


class PlaybackThread:
    """Steps a playback when it is due; pause, resume and stop come from other threads.

    ``at_end`` is called once from the thread, with None after the last message or with the error;
    not when the thread is stopped.
    """

    def __init__(self, playback: Playback, *, at_end: Callable[[Exception | None], None]) -> None:
        self._playback, self._timeline = playback, playback.timeline
        self._at_end = at_end
        self._changed = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.start = self._thread.start

    def set_paused(self, paused: bool) -> bool:
        """Pause or resume; return whether the state changed."""
        with self._changed:
            if self._timeline.paused == paused:
                return False
            self._timeline.set_paused(paused, time.monotonic_ns())
            self._changed.notify()
            return True

    def recorded_ns(self) -> int:
        """Return the recorded time now."""
        with self._changed:
            return self._timeline.recorded_ns(time.monotonic_ns())

    def stop(self) -> None:
        """Stop the thread and wait for its end."""
        # Before the lock, which a thread that is late rarely releases.
        self._stopped = True
        with self._changed:
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()
        self._playback.close()

    def _run(self) -> None:
        problem: Exception | None = None
        try:
            with self._changed:
                while not self._stopped and not self._playback.finished:
                    at_ns = self._playback.step(time.monotonic_ns())
                    if not self._playback.finished:
                        left_ns = None if at_ns is None else max(0, at_ns - time.monotonic_ns())
                        self._changed.wait(None if left_ns is None else left_ns / _S)
                if self._stopped:
                    return
        except Exception as error:  # reported by the owner of the thread
            problem = error
        self._at_end(problem)


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

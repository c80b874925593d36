"""The threads of a playback: one reads ahead, one sleeps until something is due.

Opening a chunk of a bag therefore does not delay what is due meanwhile.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from quad_mpc_ros.recordings.replay.playback import Playback, PlaybackTimeline

T = TypeVar("T")

_NS = 1e-9
_POLL_PERIOD_S = 0.1


class PlaybackThread:
    """Steps a playback when it is due; pause, resume and stop come from other threads.

    ``at_end`` is called once from the thread, with None after the last message or with the error;
    not when the thread is stopped.
    """

    def __init__(
        self,
        playback: Playback,
        timeline: PlaybackTimeline,
        *,
        at_end: Callable[[Exception | None], None],
    ) -> None:
        self._playback = playback
        self._timeline = timeline
        self._at_end = at_end
        self._changed = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def set_paused(self, paused: bool) -> bool:
        """Pause or go on; return whether that changed anything."""
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
        """End the thread and wait for it."""
        # Before the lock, which a thread that is late rarely releases.
        self._stopped = True
        with self._changed:
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        problem: Exception | None = None
        try:
            with self._changed:
                self._step_until_end()
                if self._stopped:
                    return
        except Exception as error:  # reported by the owner of the thread
            problem = error
        self._at_end(problem)

    def _step_until_end(self) -> None:
        while not self._stopped:
            at_ns = self._playback.step(time.monotonic_ns())
            if self._playback.finished:
                return
            wait_s = None if at_ns is None else max(0, at_ns - time.monotonic_ns()) * _NS
            self._changed.wait(wait_s)


class ReadAhead(Generic[T]):
    """An iterator over ``items`` that holds up to ``depth`` of them ready.

    An exception of their iteration is raised here when its turn comes.
    """

    def __init__(self, items: Iterator[T], *, depth: int) -> None:
        self._ready: queue.Queue[T | Exception] = queue.Queue(depth)  # the last is an exception
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._read, args=(items,), daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        item = self._ready.get()
        if isinstance(item, Exception):
            self._ready.put(item)
            raise item
        return item

    def close(self) -> None:
        """End the reading."""
        self._closed.set()
        self._thread.join()

    def _read(self, items: Iterator[T]) -> None:
        end: Exception = StopIteration()
        try:
            for item in items:
                if not self._put(item):
                    return
        except Exception as error:
            end = error
        self._put(end)

    def _put(self, item: T | Exception) -> bool:
        while not self._closed.is_set():
            try:
                self._ready.put(item, timeout=_POLL_PERIOD_S)
                return True
            except queue.Full:
                continue
        return False

"""The threads of a playback: one reads ahead, one sleeps until a message is due.

Opening a chunk of a bag therefore does not delay messages.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from quad_mpc_ros.recordings.replay.playback import Playback, PlaybackTimeline

T = TypeVar("T")

_NS = 1e-9


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


def read_ahead(items: Iterator[T], *, depth: int) -> Generator[T, None, None]:
    """Yield items, while another thread reads the next ``depth`` of them.

    An exception of the iteration is raised in order.
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

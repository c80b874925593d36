"""Worker processes of this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import NamedTuple

from quad_mpc_ros.campaigns.campaign import Campaign
from quad_mpc_ros.campaigns.flight import FlownFlight, fly_batch, lost_flight

_MOST_DEATHS = 2
# Libraries of linear algebra: more threads than one only wait for each other here.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class _Task(NamedTuple):
    numbers: Sequence[int]
    deaths: int = 0


class _Worker(NamedTuple):
    """One process, and what ends it when it is closed, by us or because we ended."""

    pool: ProcessPoolExecutor
    leash: Connection


class LocalWorkers:
    """Processes that each fly a batch at a time. The use is that of :class:`.engine.Engine`.

    Each is a pool of its own, so that it is known which batch was with the one that died.
    """

    def __init__(self, workers: int | None = None) -> None:
        """Take the number of processes, by default one for each processor we may use."""
        self.workers = workers or len(os.sched_getaffinity(0))
        self._idle = [_new_worker() for _ in range(self.workers)]
        self._flying: dict[Future[list[FlownFlight]], tuple[_Task, _Worker]] = {}

    def fly(
        self, campaign: Campaign, batches: Sequence[Sequence[int]]
    ) -> Iterator[list[FlownFlight]]:
        """Fly batches of numbers and yield each as it is done."""
        waiting = deque(map(_Task, batches))
        try:
            while waiting or self._flying:
                while waiting and self._idle:
                    self._hand_out(campaign, waiting.popleft())
                done, _ = wait(self._flying, return_when=FIRST_COMPLETED)
                for future in done:
                    task, worker = self._flying.pop(future)
                    try:
                        flown = future.result()
                    except BrokenProcessPool:
                        _end(worker)
                        self._idle.append(_new_worker())
                        waiting.extendleft(_again(task))
                        flown = _given_up(campaign, task)
                    else:
                        self._idle.append(worker)
                    if flown:
                        yield flown
        finally:
            self._give_up()

    def __enter__(self) -> LocalWorkers:
        return self

    def __exit__(self, *exception: object) -> None:
        for worker in self._idle:
            _end(worker)

    def _hand_out(self, campaign: Campaign, task: _Task) -> None:
        worker = self._idle.pop()
        self._flying[worker.pool.submit(fly_batch, campaign, task.numbers)] = task, worker

    def _give_up(self) -> None:
        """End what flies for nobody any more."""
        for _, worker in self._flying.values():
            _end(worker)
            self._idle.append(_new_worker())
        self._flying.clear()


def _again(task: _Task) -> list[_Task]:
    """Return what is to be flown after a death: one by one, until it is clear which one it is."""
    if len(task.numbers) > 1:
        return [_Task([number]) for number in task.numbers]
    deaths = task.deaths + 1
    return [_Task(task.numbers, deaths)] if deaths < _MOST_DEATHS else []


def _given_up(campaign: Campaign, task: _Task) -> list[FlownFlight]:
    """Return the flight after which no worker lived on, once that is clear."""
    if _again(task):
        return []
    reason = f"WorkerDied: the worker process died in this flight, {_MOST_DEATHS} times"
    return [lost_flight(campaign, number, reason) for number in task.numbers]


def _new_worker() -> _Worker:
    """Return a worker, whose process starts with its first batch."""
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    held, leash = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(
        max_workers=1, mp_context=context, initializer=_begin, initargs=(held,)
    )
    return _Worker(pool, leash)


def _end(worker: _Worker) -> None:
    worker.leash.close()
    worker.pool.shutdown(wait=False, cancel_futures=True)


def _begin(held: Connection) -> None:
    """Prepare a worker: Ctrl-C is for the one who asked, with whom the worker ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(held,), daemon=True).start()


def _end_with(held: Connection) -> None:
    """End this process as soon as nobody holds the other end."""
    with contextlib.suppress(EOFError, OSError):
        held.recv()
    os.kill(os.getpid(), signal.SIGKILL)

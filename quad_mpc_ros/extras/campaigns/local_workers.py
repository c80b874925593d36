# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Worker processes on this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import NamedTuple

from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.flight import FlownFlight, fly_batch, lost_flight

_MAX_BATCH_SIZE = 16
_BATCHES_PER_WORKER = 8
_MAX_CRASHES = 2
# Linear algebra libraries: one thread for each worker.
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class _Task(NamedTuple):
    numbers: Sequence[int]
    deaths: int = 0


class _Worker(NamedTuple):
    """A process and this end of its pipe; the process ends when the pipe is closed."""

    process: BaseProcess
    line: Connection


class LocalWorkers:
    """Processes that fly one batch at a time; leaving the context ends them.

    Each process has its own pipe, so that the batch of a process that died is known.
    """

    def __init__(self, workers: int | None = None) -> None:
        """Set the number of processes; default: one for each available processor."""
        self.workers = workers or len(os.sched_getaffinity(0))
        self._idle: list[_Worker] = []
        self._flying: dict[Connection, tuple[_Task, _Worker]] = {}

    def fly(
        self, campaign: Campaign, batches: Sequence[Sequence[int]]
    ) -> Iterator[list[FlownFlight]]:
        """Fly batches of flight numbers and yield finished batches, in any order.

        A worker that dies is replaced, and its batch is flown again. A flight that kills two
        workers is returned with an error. Closing the iterator ends flights in progress.
        """
        waiting = deque(map(_Task, batches))
        try:
            while waiting or self._flying:
                while waiting and len(self._flying) < self.workers:
                    self._hand_out(campaign, waiting.popleft())
                for line in wait(list(self._flying)):
                    assert isinstance(line, Connection)
                    task, worker = self._flying.pop(line)
                    try:
                        flown = line.recv()
                    except (EOFError, OSError):
                        _end(worker)
                        waiting.extendleft(_again(task))
                        flown = _given_up(campaign, task)
                    else:
                        self._idle.append(worker)
                    if isinstance(flown, Exception):
                        raise flown
                    if flown:
                        yield flown
        finally:
            self._give_up()

    def __enter__(self) -> LocalWorkers:
        return self

    def __exit__(self, *exception: object) -> None:
        for worker in self._idle:
            _end(worker)
        self._idle.clear()

    def _hand_out(self, campaign: Campaign, task: _Task) -> None:
        worker = self._idle.pop() if self._idle else _new_worker()
        self._flying[worker.line] = task, worker
        with contextlib.suppress(OSError):  # the worker has died, see wait in fly
            worker.line.send((campaign, task.numbers))

    def _give_up(self) -> None:
        """End the workers with flights in progress."""
        for _, worker in self._flying.values():
            _end(worker)
        self._flying.clear()


def batched(numbers: Sequence[int], *, workers: int) -> list[Sequence[int]]:
    """Return the numbers in batches.

    Large batches cost less communication. Small batches keep all workers busy to the end, and
    less is lost if a worker dies.
    """
    size = len(numbers) // (_BATCHES_PER_WORKER * workers)
    size = min(max(size, 1), _MAX_BATCH_SIZE)
    return [numbers[begin : begin + size] for begin in range(0, len(numbers), size)]


def _again(task: _Task) -> list[_Task]:
    """Return the tasks after a worker died: single flights, to find the fatal flight."""
    if len(task.numbers) > 1:
        return [_Task([number]) for number in task.numbers]
    deaths = task.deaths + 1
    return [_Task(task.numbers, deaths)] if deaths < _MAX_CRASHES else []


def _given_up(campaign: Campaign, task: _Task) -> list[FlownFlight]:
    """Return the flight that killed its workers, once known."""
    if _again(task):
        return []
    reason = f"WorkerDied: the worker process died in this flight, {_MAX_CRASHES} times"
    return [lost_flight(campaign, number, reason) for number in task.numbers]


def _new_worker() -> _Worker:
    for name in _THREAD_VARIABLES:
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    line, its_end = context.Pipe()
    process = context.Process(target=_work, args=(its_end,), daemon=True)
    # Otherwise the first worker starts it, which unblocks SIGINT.
    resource_tracker.ensure_running()
    # Ctrl-C is for the parent, which ends the worker; blocked before the worker's first line.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    its_end.close()  # now only the worker has it open
    return _Worker(process, line)


def _end(worker: _Worker) -> None:
    worker.process.kill()
    worker.process.join()
    worker.process.close()
    worker.line.close()


def _work(line: Connection) -> None:
    """Fly the batches from the pipe, in a worker process, until its other end is closed."""
    tasks: SimpleQueue[tuple[Campaign, Sequence[int]]] = SimpleQueue()

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                tasks.put(line.recv())
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        campaign, numbers = tasks.get()
        try:
            line.send(fly_batch(campaign, numbers))
        except Exception as error:  # for the parent
            line.send(error)

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Worker processes on this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.flight import FlownFlight, fly_batch

_MAX_BATCH_SIZE = 16
_BATCHES_PER_WORKER = 8
# Linear algebra libraries: one thread for each worker.
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class LocalWorkers:
    """Processes that fly one batch at a time; leaving the context ends them."""

    def __init__(self, workers: int | None = None) -> None:
        """Set the number of processes; default: one for each available processor."""
        self.workers = workers or len(os.sched_getaffinity(0))
        for name in _THREAD_VARIABLES:
            os.environ.setdefault(name, "1")
        context = multiprocessing.get_context("spawn")
        parent, self._line = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(
            self.workers, mp_context=context, initializer=_end_with, initargs=(parent,)
        )

    def fly(
        self, campaign: Campaign, batches: Sequence[Sequence[int]]
    ) -> Iterator[list[FlownFlight]]:
        """Fly batches of flight numbers and yield finished batches, in any order.

        Raises :class:`UserError` if a worker dies.
        """
        # Ctrl-C is for the parent; new processes inherit the blocked signals.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            flying = [self._pool.submit(fly_batch, campaign, numbers) for numbers in batches]
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            for flown in as_completed(flying):
                yield flown.result()
        except BrokenProcessPool as error:
            raise UserError(
                "a worker process died, for example without free memory: fly again with less "
                "--workers"
            ) from error

    def __enter__(self) -> LocalWorkers:
        return self

    def __exit__(self, *exception: object) -> None:
        self._pool.shutdown(wait=False)
        self._line.close()


def batched(numbers: Sequence[int], *, workers: int) -> list[Sequence[int]]:
    """Return the numbers in batches.

    Large batches cost less communication. Small batches keep all workers busy to the end.
    """
    size = len(numbers) // (_BATCHES_PER_WORKER * workers)
    size = min(max(size, 1), _MAX_BATCH_SIZE)
    return [numbers[begin : begin + size] for begin in range(0, len(numbers), size)]


def _end_with(parent: Connection) -> None:
    """End this worker, also in a flight, when the parent has closed the pipe or has died."""

    def wait() -> None:
        parent.poll(None)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()

"""Workers of a Dask cluster that is there already."""

from __future__ import annotations

import importlib
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from quad_mpc_ros import __version__
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.flight import FlownFlight, fly_batch, lost_flight

_DASK_REQUIRED = "--scheduler needs Dask: pip install 'quad_mpc_ros[campaign]'"
PATIENCE = 10.0  # s
_BATCHES_PER_WORKER = 3  # batches handed out for each worker, so that none waits for the next one


class DaskWorkers:
    """The workers that a scheduler has. The use is that of :class:`.engine.Engine`.

    Dask flies what a worker held again when that dies; a batch with which several die is flown
    one by one here.
    """

    def __init__(self, address: str) -> None:
        """Connect to a scheduler.

        Raises :class:`UserError` where Dask is not installed, no scheduler answers, it has no
        workers, or they cannot fly.
        """
        distributed = _distributed()
        try:
            self._client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise UserError(
                f"--scheduler: no Dask scheduler answers at {address!r} within {PATIENCE:g} s "
                f"({type(error).__name__}): expected an address such as tcp://127.0.0.1:8786"
            ) from error
        try:
            self.workers = self._checked_workers(address)
        except BaseException:
            self._client.close()
            raise
        self._as_completed = distributed.as_completed
        self._killed = distributed.KilledWorker

    def fly(
        self, campaign: Campaign, batches: Sequence[Sequence[int]]
    ) -> Iterator[list[FlownFlight]]:
        """Fly batches of numbers and yield each as it is done."""
        shared = self._client.scatter(campaign, broadcast=False, hash=False)
        waiting = deque(batches)
        flying: dict[Any, Sequence[int]] = {}
        done = self._as_completed(loop=self._client.loop)
        try:
            while waiting or flying:
                while waiting and len(flying) < _BATCHES_PER_WORKER * self.workers:
                    numbers = waiting.popleft()
                    future = self._client.submit(fly_batch, shared, list(numbers), pure=False)
                    flying[future] = numbers
                    done.add(future)
                future = next(done)
                numbers = flying.pop(future)
                try:
                    yield future.result()
                except self._killed as error:
                    if len(numbers) > 1:
                        waiting.extendleft([number] for number in numbers)
                    else:
                        reason = f"WorkerDied: {' '.join(str(error).split())}"
                        yield [lost_flight(campaign, numbers[0], reason)]
        finally:
            self._client.cancel(list(flying))

    def __enter__(self) -> DaskWorkers:
        return self

    def __exit__(self, *exception: object) -> None:
        self._client.close()

    def _checked_workers(self, address: str) -> int:
        """Return how many threads there are, of workers that have the same package."""
        try:
            versions = self._client.run(_version)
        except Exception as error:
            raise UserError(
                f"--scheduler: the workers at {address} cannot import quad_mpc_ros: {error}: "
                "install it there"
            ) from error
        if not versions:
            raise UserError(f"--scheduler: the scheduler at {address} has no workers: start some")
        for worker, version in versions.items():
            if version != __version__:
                raise UserError(
                    f"--scheduler: {worker} has quad_mpc_ros {version}, here is {__version__}: "
                    "install the same"
                )
        return sum(self._client.nthreads().values())


def _version() -> str:
    """Return the version where this runs, on a worker."""
    return __version__


def _distributed() -> Any:
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise UserError(f"{error}. {_DASK_REQUIRED}") from error

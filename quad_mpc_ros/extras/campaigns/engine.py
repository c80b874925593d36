"""What flies the flights of a campaign: workers, here or elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.flight import FlownFlight

_MAX_BATCH_SIZE = 16
_BATCHES_PER_WORKER = 8


class Engine(Protocol):
    """Flies batches of flights on workers; leaving the context ends them."""

    @property
    def workers(self) -> int:
        """How many there are."""

    def fly(
        self, campaign: Campaign, batches: Sequence[Sequence[int]]
    ) -> Iterator[list[FlownFlight]]:
        """Fly batches of numbers and yield each as it is done, in any order.

        A worker that dies is replaced, and what it flew is flown again. A flight that no worker
        survives comes with an error. Closing the iterator gives up what is under way.
        """

    def __enter__(self) -> Engine: ...

    def __exit__(self, *exception: object) -> None: ...


def batched(numbers: Sequence[int], *, workers: int) -> list[Sequence[int]]:
    """Return the numbers in batches: large enough to cost little to hand out, small enough that
    all workers have some to the end and little is lost with one.
    """
    size = len(numbers) // (_BATCHES_PER_WORKER * workers)
    size = min(max(size, 1), _MAX_BATCH_SIZE)
    return [numbers[begin : begin + size] for begin in range(0, len(numbers), size)]

"""The flights of one trial, until the end or until too many crashed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched
from quad_mpc_ros.extras.campaigns.table import NUMBER, Row
from quad_mpc_ros.extras.campaigns.tuning.objectives import is_lost

_FIRST_CHECK = 8

Observer = Callable[[int], None]
"""Called after each batch with the number of finished flights of the trial."""


@dataclass(frozen=True, kw_only=True)
class TrialFlights:
    """Rows of the flights by campaign; campaigns not yet started have none."""

    rows: Mapping[str, list[Row]]
    given_up: bool

    @property
    def flights(self) -> int:
        """Number of flights."""
        return sum(map(len, self.rows.values()))

    @property
    def lost(self) -> int:
        """Number of lost flights."""
        return sum(is_lost(row) for rows in self.rows.values() for row in rows)


def fly_trial(
    campaigns: Mapping[str, Campaign],
    engine: LocalWorkers,
    *,
    give_up: float | None,
    observe: Observer | None = None,
) -> TrialFlights:
    """Fly campaigns in order, until more than a share ``give_up`` of a campaign's flights is lost.

    The share is checked after 8, 16, 32 … flights. The share refers to all flights of the
    campaign, so that a trial that would stay below is never given up. Flights beyond the check do
    not count, so that the result does not depend on the number of workers. None never gives up.
    """
    rows: dict[str, list[Row]] = {}
    for name, campaign in campaigns.items():
        before = sum(map(len, rows.values()))
        rows[name] = []
        looks = _looks(campaign.flights) if give_up is not None else [campaign.flights]
        for look in looks:
            if len(rows[name]) < look:
                first = len(rows[name])
                last = min(max(look, first + 2 * engine.workers), campaign.flights)
                numbers = range(first, last)
                rows[name] += _flown(campaign, engine, numbers, before + first, observe)
            counted = rows[name][:look]
            if give_up is not None and sum(map(is_lost, counted)) > give_up * campaign.flights:
                rows[name] = counted
                return TrialFlights(rows=rows, given_up=True)
    return TrialFlights(rows=rows, given_up=False)


def _flown(
    campaign: Campaign,
    engine: LocalWorkers,
    numbers: Sequence[int],
    done: int,
    observe: Observer | None,
) -> list[Row]:
    found: dict[int, Row] = {}
    for flown in engine.fly(campaign, batched(numbers, workers=engine.workers)):
        found |= {int(flight.row[NUMBER]): flight.row for flight in flown}
        if observe is not None:
            observe(done + len(found))
    return [found[number] for number in numbers]


def _looks(flights: int) -> list[int]:
    looks, look = [], _FIRST_CHECK
    while look < flights:
        looks.append(look)
        look *= 2
    return [*looks, flights]

"""The flights of one trial: all that its campaigns have, or so many that it is clearly bad."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched
from quad_mpc_ros.extras.campaigns.table import NUMBER, Row
from quad_mpc_ros.extras.campaigns.tuning.objectives import is_lost

_FIRST_CHECK = 8

Observer = Callable[[int], None]
"""Called after each batch with the number of flights of the trial flown."""


@dataclass(frozen=True, kw_only=True)
class TrialFlights:
    """What a trial flew: rows in order, by the campaign's name; none of those not begun."""

    rows: Mapping[str, list[Row]]
    given_up: bool

    @property
    def flights(self) -> int:
        """How many count."""
        return sum(map(len, self.rows.values()))

    @property
    def lost(self) -> int:
        """How many of them were lost."""
        return sum(is_lost(row) for rows in self.rows.values() for row in rows)


def fly_trial(
    campaigns: Mapping[str, Campaign],
    engine: LocalWorkers,
    *,
    give_up: float | None,
    observe: Observer | None = None,
) -> TrialFlights:
    """Fly campaigns in order, until more than a share of one's flights is lost.

    That is looked at after the first 8, 16, 32 … flights. Since the share is one of all flights
    and not of those flown so far, no trial is given up that would have kept below it. On how many
    workers it is flown changes nothing: flights that were flown ahead of the look do not count.
    With None nothing is given up.
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

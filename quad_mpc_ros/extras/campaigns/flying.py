"""Flying a campaign into a folder, and going on with one that was stopped."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.extras.campaigns.campaign import Campaign, number_text
from quad_mpc_ros.extras.campaigns.campaign_file import (
    campaign_text,
    identity_text,
    read_campaign,
)
from quad_mpc_ros.extras.campaigns.flight import FlownFlight, column_names
from quad_mpc_ros.extras.campaigns.journal import NAME as JOURNAL_NAME
from quad_mpc_ros.extras.campaigns.journal import Journal
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched
from quad_mpc_ros.extras.campaigns.table import CSV_NAME, Row, write_table

CAMPAIGN_NAME = "campaign.yaml"
FIGURE_NAME = "campaign.png"
FLIGHTS_NAME = "flights"
HOLDS = (CAMPAIGN_NAME, FLIGHTS_NAME, JOURNAL_NAME, CSV_NAME, FIGURE_NAME)
"""What the folder of a campaign holds, and must not hold before."""

Observer = Callable[[int, int, int], None]
"""Called after each batch: flights done, flights in all, crashed."""


def begin(campaign: Campaign, folder: Path) -> None:
    """Write a campaign into its empty folder. Raises ``OSError``."""
    (folder / FLIGHTS_NAME).mkdir()
    (folder / CAMPAIGN_NAME).write_text(campaign_text(campaign), encoding="utf-8")


def campaign_of(folder: Path) -> Campaign:
    """Return the campaign of a folder. Raises :class:`UserError` for a folder of none."""
    if not (folder / CAMPAIGN_NAME).is_file():
        raise UserError(f"{folder}: not the folder of a campaign: it has no {CAMPAIGN_NAME}")
    return read_campaign(folder / CAMPAIGN_NAME)


def grown(campaign: Campaign, flights: int | None, folder: Path) -> Campaign:
    """Return the campaign of a folder with so many flights, None for as many as it has.

    Flight NUMBER is the same in a longer campaign. Raises :class:`UserError` for fewer, for a
    grid, and for more than the names of its files have digits for.
    """
    if flights is None or flights == campaign.flights:
        return campaign
    if campaign.grid:
        raise UserError(f"--flights: {folder} is a grid: it has {campaign.flights} combinations")
    if flights < campaign.flights:
        raise UserError(
            f"--flights: given {flights}, but the campaign of {folder} has {campaign.flights}: "
            "it may get more flights, not fewer; start again with another --out"
        )
    longer = dataclasses.replace(campaign, flights=flights)
    if len(number_text(0, flights)) != len(number_text(0, campaign.flights)):
        raise UserError(
            f"--flights: given {flights}, but the flights of {folder} are numbered with "
            f"{len(number_text(0, campaign.flights))} digits: start again with another --out"
        )
    return longer


def fly_into(
    folder: Path, campaign: Campaign, engine: LocalWorkers, observe: Observer | None = None
) -> list[Row]:
    """Fly what is left to fly of the campaign in a folder, and write its table.

    Each batch is on disk before the next one counts. The campaign may have more flights than the
    folder says, which then says so too. Raises ``OSError``, and :class:`UserError` if the
    campaign has changed in anything else.
    """
    with Journal(folder, campaign_text=identity_text(campaign_of(folder))) as journal:
        text = campaign_text(campaign)
        write_atomically(folder / CAMPAIGN_NAME, text, overwrite=True)
        left = [number for number in range(campaign.flights) if number not in journal.rows]
        crashed = sum(bool(row["crashed"]) for row in journal.rows.values())
        for flown in engine.fly(campaign, batched(left, workers=engine.workers)):
            for flight in flown:
                _write_parameters(folder, flight, campaign.flights)
            journal.add(flight.row for flight in flown)
            crashed += sum(bool(flight.row["crashed"]) for flight in flown)
            if observe is not None:
                observe(len(journal.rows), campaign.flights, crashed)
        rows = list(journal.rows.values())
    write_table(folder, rows, column_names(campaign))
    return rows


def fly(campaign: Campaign, engine: LocalWorkers) -> list[Row]:
    """Fly a campaign and return its rows in order, without a file."""
    numbers = range(campaign.flights)
    batches = engine.fly(campaign, batched(numbers, workers=engine.workers))
    rows = {int(flight.row["flight"]): flight.row for flown in batches for flight in flown}
    return [rows[number] for number in sorted(rows)]


def _write_parameters(folder: Path, flight: FlownFlight, flights: int) -> None:
    if flight.parameter_file:
        name = f"{number_text(int(flight.row['flight']), flights)}.yaml"
        (folder / FLIGHTS_NAME / name).write_text(flight.parameter_file, encoding="utf-8")

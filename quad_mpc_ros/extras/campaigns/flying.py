"""Flying a campaign into a folder, and resuming an interrupted one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.campaign import Campaign, number_text
from quad_mpc_ros.extras.campaigns.campaign_file import campaign_text, read_campaign
from quad_mpc_ros.extras.campaigns.flight import FlownFlight, column_names
from quad_mpc_ros.extras.campaigns.journal import CSV_NAME, Journal, Row, write_table
from quad_mpc_ros.extras.campaigns.journal import NAME as JOURNAL_NAME
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched

CAMPAIGN_NAME = "campaign.yaml"
FLIGHTS_NAME, FIGURE_NAME = "flights", "campaign.png"
HOLDS = (CAMPAIGN_NAME, FLIGHTS_NAME, JOURNAL_NAME, CSV_NAME, FIGURE_NAME)
"""Content of a campaign's folder, which a new folder must not have."""

Observer = Callable[[int, int, int], None]
"""Called after each batch with the numbers of finished, all and crashed flights."""


def begin(campaign: Campaign, folder: Path) -> None:
    """Write a campaign into its empty folder. Raises ``OSError``."""
    (folder / FLIGHTS_NAME).mkdir()
    (folder / CAMPAIGN_NAME).write_text(campaign_text(campaign), encoding="utf-8")


def campaign_of(folder: Path) -> Campaign:
    """Return the campaign in a folder. Raises :class:`UserError` without a campaign."""
    if not (folder / CAMPAIGN_NAME).is_file():
        raise UserError(f"{folder}: not the folder of a campaign: it has no {CAMPAIGN_NAME}")
    return read_campaign(folder / CAMPAIGN_NAME)


def fly_into(
    folder: Path, campaign: Campaign, engine: LocalWorkers, observe: Observer | None = None
) -> list[Row]:
    """Fly the remaining flights of the campaign in a folder, and write the table.

    Each batch is on disk before the next batch counts. Raises ``OSError``, and :class:`UserError`
    if the campaign has changed since its first flight.
    """
    with Journal(folder, campaign_text=campaign_text(campaign)) as journal:
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


def _write_parameters(folder: Path, flight: FlownFlight, flights: int) -> None:
    if flight.parameter_file:
        name = f"{number_text(int(flight.row['flight']), flights)}.yaml"
        (folder / FLIGHTS_NAME / name).write_text(flight.parameter_file, encoding="utf-8")

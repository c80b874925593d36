# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Flying a campaign into a folder, and its result as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.extras.campaigns.campaign import Campaign, number_text
from quad_mpc_ros.extras.campaigns.campaign_file import campaign_text
from quad_mpc_ros.extras.campaigns.flight import FlownFlight, column_names
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched
from quad_mpc_ros.extras.campaigns.table import CSV_NAME, NUMBER, Row, write_table
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles

CAMPAIGN_NAME = "campaign.yaml"
FLIGHTS_NAME, FIGURE_NAME = "flights", "campaign.png"
HOLDS = (CAMPAIGN_NAME, FLIGHTS_NAME, CSV_NAME, FIGURE_NAME)
"""Content of a campaign's folder, which a new folder must not have."""

Observer = Callable[[int, int, int], None]
"""Called after each batch with the numbers of finished, all and crashed flights."""
_LISTED_FIGURES = (
    "settled_error_mean_m",
    "settled_error_max_m",
    "position_rmse_m",
    "tilt_max_rad",
    "settled_tilt_max_rad",
    "speed_max_m_s",
    "rates_rms_rad_s",
)


def begin(campaign: Campaign, folder: Path) -> None:
    """Write a campaign into its empty folder. Raises ``OSError``."""
    (folder / FLIGHTS_NAME).mkdir()
    (folder / CAMPAIGN_NAME).write_text(campaign_text(campaign), encoding="utf-8")


def fly_into(
    folder: Path, campaign: Campaign, engine: LocalWorkers, observe: Observer | None = None
) -> list[Row]:
    """Fly a campaign into the folder, and write the table. Raises ``OSError``.

    The table of the finished flights is also written if a worker dies or the user interrupts.
    """
    rows: list[Row] = []
    batches = batched(range(campaign.flights), workers=engine.workers)
    try:
        for flown in engine.fly(campaign, batches):
            for flight in flown:
                _write_parameters(folder, flight, campaign.flights)
                rows.append(flight.row)
            if observe is not None:
                observe(len(rows), campaign.flights, sum(bool(row["crashed"]) for row in rows))
    finally:
        rows.sort(key=lambda row: int(row[NUMBER]))
        write_table(folder, rows, column_names(campaign))
    return rows


def _write_parameters(folder: Path, flight: FlownFlight, flights: int) -> None:
    if flight.parameter_file:
        name = f"{number_text(int(flight.row['flight']), flights)}.yaml"
        (folder / FLIGHTS_NAME / name).write_text(flight.parameter_file, encoding="utf-8")


def counts_text(rows: Sequence[Row]) -> str:
    """Return the numbers of flights that crashed, ended with an error, and completed."""
    kinds = Counter(row["crash"] for row in rows if row["crashed"])
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    errors = sum(bool(row.get("error")) for row in rows)
    return (
        f"{len(rows)} flights: {kinds.total()} crashed{f' ({counts})' if counts else ''}, "
        f"{errors} ended with an error, {len(rows) - errors - kinds.total()} completed"
    )


def results_text(folder: Path, campaign: Campaign, rows: Sequence[Row]) -> str:
    """Return the numbers of crashes and errors, percentiles of the other flights, and files."""
    errors = [row for row in rows if row.get("error")]
    flown = [row for row in rows if not row["crashed"] and not row.get("error")]
    lines = [counts_text(rows), "", *_percentiles(flown), ""]
    if errors:
        lines.append(f"error    flight {errors[0][NUMBER]}: {errors[0]['error']}")
    if rows and (worst := _worst(rows)) is not None:
        name = f"{number_text(int(worst[NUMBER]), campaign.flights)}.yaml"
        lines.append(f"worst    quad_mpc simulate --config {folder / 'flights' / name}")
    lines.append(f"table    {folder / CSV_NAME}")
    lines.append(f"figure   {folder / FIGURE_NAME}")
    return "\n".join(lines)


def _percentiles(flown: Sequence[Row]) -> list[str]:
    """Return a table of percentiles."""
    table = [["completed flights", "p50", "p95", "p99", "max"]]
    for name in _LISTED_FIGURES:
        values = [float(row[name]) for row in flown if row.get(name) is not None]
        if values:
            shown = percentiles(values, 50, 95, 99)
            table.append([name, *(f"{value:.3g}" for value in shown.values())])
    return text_table(table, align="lrrrr")


def _worst(rows: Sequence[Row]) -> Row | None:
    """Return the flight that crashed first; without a crash, the flight with the largest error."""
    crashed = [row for row in rows if row["crashed"]]
    if crashed:
        return min(crashed, key=lambda row: float(row["crash_time_s"]))
    settled = [row for row in rows if row.get("settled_error_max_m") is not None]
    return max(settled, key=lambda row: float(row["settled_error_max_m"]), default=None)

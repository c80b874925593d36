"""``quad_mpc campaign``: many flights that differ, flown on every core or on a cluster."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.campaign_options import (
    add_campaign_options,
    engine_of,
    new_or_resumed,
)
from quad_mpc_ros.commands.output import prepared_out, results_in
from quad_mpc_ros.commands.progress import CountProgress

if TYPE_CHECKING:
    from quad_mpc_ros.experiments.campaigns.campaign import Campaign


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add which campaign, over which parameters, with which workers, into what."""
    parser.description = (
        "Fly many flights of the closed loop without ROS, with parameters that a file varies "
        "from flight to flight (docs/campaigns.md). Writes flights.csv and, with pyarrow, "
        "flights.parquet, a row a flight; flights/NUMBER.yaml, with which 'quad_mpc simulate "
        "--config' makes one again; and, with Plotly, report.html. Exit code 0 when all were "
        "flown, crashed or not. Ctrl-C or a kill loses only the flights under way."
    )
    add_campaign_options(parser, "campaign")
    parser.add_argument(
        "--flights",
        type=int,
        metavar="N",
        help="number of flights, instead of the file's; with --resume more than it has",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="seed, instead of the file's")


def run(options: argparse.Namespace) -> int:
    """Fly what is left to fly, print how it went, and return the exit code."""
    from quad_mpc_ros.analysis.report import PLOTLY_NEEDED
    from quad_mpc_ros.experiments.campaign_report import write_campaign_page
    from quad_mpc_ros.experiments.campaigns.flying import HOLDS, begin, fly_into
    from quad_mpc_ros.experiments.campaigns.results import results_text

    campaign, out = _campaign(options)
    with engine_of(options) as engine, results_in(out):
        if options.resume is None:
            begin(campaign, prepared_out(out, holds=HOLDS))
        print(
            f"flying {campaign.flights} flights with {engine.workers} workers into {out}",
            file=sys.stderr,
        )
        progress = CountProgress()
        try:
            rows = fly_into(out, campaign, engine, progress.show)
        except KeyboardInterrupt:
            print(f"\nto continue: quad_mpc campaign --resume {out}", file=sys.stderr)
            raise
        finally:
            progress.close()
    print(results_text(out, campaign, rows))
    with results_in(out):
        page = write_campaign_page(out)
    print(f"report   {page or PLOTLY_NEEDED}")
    return 0


def _campaign(options: argparse.Namespace) -> tuple[Campaign, Path]:
    """Return the campaign that is asked for and its folder."""
    from quad_mpc_ros.experiments.campaigns.campaign_file import (
        Overrides,
        identity_text,
        located_campaign,
        read_campaign,
    )
    from quad_mpc_ros.experiments.campaigns.flying import campaign_of, grown

    overrides = Overrides(
        config=options.config,
        assignments=options.assignments,
        flights=options.flights,
        seed=options.seed,
    )
    campaign, out = new_or_resumed(
        options,
        "campaign",
        read=lambda: read_campaign(located_campaign(options.file), overrides),
        read_folder=campaign_of,
        text=identity_text,
        overrides=bool(options.config or options.assignments) or options.seed is not None,
    )
    if options.resume is None:
        return campaign, out
    return grown(campaign, options.flights, out), out

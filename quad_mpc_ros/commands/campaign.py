"""``quad_mpc campaign``: many flights that differ, flown on every core or on a cluster."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.campaign_options import (
    add_campaign_options,
    campaign_folder,
    engine_of,
    new_or_resumed,
)
from quad_mpc_ros.commands.output import results_in
from quad_mpc_ros.commands.progress import ProgressLine

if TYPE_CHECKING:
    from quad_mpc_ros.extras.campaigns.campaign import Campaign


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add which campaign, over which parameters, with which workers, into what."""
    parser.description = (
        "Fly many flights of the closed loop without ROS, with parameters that a file varies "
        "from flight to flight (docs/howto/campaigns.md). Writes flights.csv, a row a flight; "
        "flights/NUMBER.yaml, with which 'quad_mpc simulate --config' makes one again; and "
        "campaign.png. Exit code 0 when all were flown, crashed or not. Ctrl-C or a kill loses "
        "only the flights under way."
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
    from quad_mpc_ros.extras.campaigns.figure import write_figure
    from quad_mpc_ros.extras.campaigns.flying import HOLDS, begin, fly_into
    from quad_mpc_ros.extras.campaigns.results import results_text

    campaign = _campaign(options)
    with engine_of(options) as engine, campaign_folder(options, HOLDS) as out:
        if options.resume is None:
            begin(campaign, out)
        print(
            f"flying {campaign.flights} flights with {engine.workers} workers into {out}",
            file=sys.stderr,
        )
        progress = ProgressLine()
        try:
            rows = fly_into(out, campaign, engine, _observer(progress))
        except KeyboardInterrupt:
            print(f"\nto continue: quad_mpc campaign --resume {out}", file=sys.stderr)
            raise
        finally:
            progress.close()
    print(results_text(out, campaign, rows))
    with results_in(out):
        print(f"figure   {write_figure(out, campaign, rows)}")
    return 0


def _observer(progress: ProgressLine) -> Callable[[int, int, int], None]:
    """Return what shows how many flights are done, how many crashed, and the time left."""
    first: list[int] = []  # flights that a resumed campaign had done before

    def observe(done: int, total: int, crashed: int) -> None:
        if not first:
            first.append(done)
        if progress.due or done == total:
            left = (total - done) * progress.seconds / max(done - first[0], 1)
            when = f"   {left:5.0f} s left" if done > first[0] else ""
            progress.show(f"{done} of {total} flights, {crashed} crashed{when}")

    return observe


def _campaign(options: argparse.Namespace) -> Campaign:
    """Return the campaign that is asked for."""
    from quad_mpc_ros.extras.campaigns.campaign_file import (
        Overrides,
        located_campaign,
        read_campaign,
    )
    from quad_mpc_ros.extras.campaigns.flying import campaign_of, grown

    overrides = Overrides(
        config=options.config,
        assignments=options.assignments,
        flights=options.flights,
        seed=options.seed,
    )
    campaign = new_or_resumed(
        options,
        "campaign",
        read=lambda: read_campaign(located_campaign(options.file), overrides),
        read_folder=campaign_of,
        overrides=bool(options.config or options.assignments) or options.seed is not None,
    )
    if options.resume is None:
        return campaign
    return grown(campaign, options.flights, options.resume)

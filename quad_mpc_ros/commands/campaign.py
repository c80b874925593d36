# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc campaign``: many flights with varied parameters, on all cores."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.campaign_options import (
    add_campaign_options,
    campaign_folder,
    engine_of,
    new_or_resumed,
)
from quad_mpc_ros.commands.progress import ProgressLine
from quad_mpc_ros.commands.run_options import add_controller

if TYPE_CHECKING:
    from quad_mpc_ros.extras.campaigns.campaign import Campaign


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the campaign, the parameters, the workers and the output."""
    parser.description = (
        "Fly many flights of the closed loop without ROS, with parameters that vary from flight "
        "to flight as a file states (docs/howto/campaigns.md). Writes flights.csv with a row for "
        "each flight, flights/NUMBER.yaml to repeat a flight with 'quad_mpc simulate --config', "
        "and campaign.png with the errors over each varied parameter. Exit code 0 if all flights "
        "were flown, crashed or not. Ctrl-C or a kill loses only the running flights."
    )
    add_campaign_options(parser, "campaign")
    add_controller(parser)
    parser.add_argument(
        "--flights", type=int, metavar="N", help="number of flights; overrides the file"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="seed; overrides the file")


def run(options: argparse.Namespace) -> int:
    """Fly the remaining flights, print the results, and return the exit code."""
    from quad_mpc_ros.extras.campaigns.figure import write_figure
    from quad_mpc_ros.extras.campaigns.flying import HOLDS, begin, fly_into, results_text

    campaign = _campaign(options)
    with engine_of(options) as engine, campaign_folder(options, HOLDS) as out:
        if options.resume is None:
            begin(campaign, out)
        print(
            f"flying {campaign.flights} flights with {engine.workers} workers into {out}",
            file=sys.stderr,
        )
        progress = ProgressLine()

        def observe(done: int, total: int, crashed: int) -> None:
            progress.show(f"{done} of {total} flights, {crashed} crashed", always=done == total)

        try:
            rows = fly_into(out, campaign, engine, observe)
        except KeyboardInterrupt:
            print(f"\nto continue: quad_mpc campaign --resume {out}", file=sys.stderr)
            raise
        finally:
            progress.close()
        write_figure(out, campaign, rows)
    print(results_text(out, campaign, rows))
    return 0


def _campaign(options: argparse.Namespace) -> Campaign:
    """Return the requested campaign."""
    from quad_mpc_ros.extras.campaigns.campaign_file import (
        Overrides,
        located_campaign,
        read_campaign,
    )
    from quad_mpc_ros.extras.campaigns.flying import campaign_of

    overrides = Overrides(
        config=options.config,
        assignments=options.assignments,
        flights=options.flights,
        seed=options.seed,
    )
    return new_or_resumed(
        options,
        "campaign",
        read=lambda: read_campaign(located_campaign(options.file), overrides),
        read_folder=campaign_of,
        overrides=bool(options.config or options.assignments)
        or (options.flights, options.seed) != (None, None),
    )

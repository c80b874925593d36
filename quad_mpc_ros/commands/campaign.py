# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc campaign``: many flights with varied parameters, on all cores."""

from __future__ import annotations

import argparse
import contextlib
import sys

from quad_mpc_ros.commands.campaign_options import add_campaign_options, engine_of
from quad_mpc_ros.commands.output import create_out, prepared_out, results_in
from quad_mpc_ros.commands.progress import ProgressLine
from quad_mpc_ros.commands.run_options import add_controller


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the campaign, the parameters, the workers and the output."""
    parser.description = (
        "Fly many flights of the closed loop without ROS, with parameters that vary from flight "
        "to flight as a file states (docs/howto/campaigns.md). Writes flights.csv with a row for "
        "each flight, flights/NUMBER.yaml to repeat a flight with 'quad_mpc simulate --config', "
        "and campaign.png with the errors over each varied parameter. Exit code 0 if all flights "
        "were flown, crashed or not."
    )
    add_campaign_options(parser, "campaign")
    add_controller(parser)
    parser.add_argument(
        "--flights", type=int, metavar="N", help="number of flights; overrides the file"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="seed; overrides the file")


def run(options: argparse.Namespace) -> int:
    """Fly the campaign, print the results, and return the exit code."""
    from quad_mpc_ros.extras.campaigns.campaign_file import (
        Overrides,
        located_campaign,
        read_campaign,
    )
    from quad_mpc_ros.extras.campaigns.figure import write_figure
    from quad_mpc_ros.extras.campaigns.flying import HOLDS, begin, fly_into, results_text

    overrides = Overrides(
        config=options.config,
        assignments=options.assignments,
        flights=options.flights,
        seed=options.seed,
    )
    campaign = read_campaign(located_campaign(options.file), overrides)
    with engine_of(options) as engine:
        out = prepared_out(options.out or create_out(options.file.stem), holds=HOLDS)
        print(
            f"flying {campaign.flights} flights with {engine.workers} workers into {out}",
            file=sys.stderr,
        )
        progress = ProgressLine()

        def observe(done: int, total: int, crashed: int) -> None:
            progress.show(f"{done} of {total} flights, {crashed} crashed", always=done == total)

        with results_in(out), contextlib.closing(progress):
            begin(campaign, out)
            rows = fly_into(out, campaign, engine, observe)
            write_figure(out, campaign, rows)
    print(results_text(out, campaign, rows))
    return 0

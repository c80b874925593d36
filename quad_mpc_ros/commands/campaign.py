"""``quad_mpc campaign``: many flights that differ, flown on every core or on a cluster."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.engines import add_engine_options, engine_of
from quad_mpc_ros.commands.output import default_out, prepared_out, results_in
from quad_mpc_ros.commands.progress import CountProgress
from quad_mpc_ros.commands.run_options import add_config, add_out, add_set
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.experiments.campaigns.campaign import Campaign


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add which campaign, over which parameters, with which workers, into what."""
    parser.description = (
        "Fly many flights of the closed loop without ROS, with parameters that vary from flight "
        "to flight as a file says (docs/campaigns.md). Writes flights.csv and, with pyarrow, "
        "flights.parquet, a row a flight; flights/NUMBER.yaml, with which 'quad_mpc simulate "
        "--config' makes one again; and, with Plotly, report.html. Exit code 0 when all were "
        "flown, whatever became of them. Ctrl-C or a kill loses what is under way, no more."
    )
    parser.add_argument(
        "file",
        type=Path,
        nargs="?",
        metavar="FILE",
        help="campaign file; may be left out with --resume",
    )
    add_out(parser, "the campaign; must not hold one", "<name of the file>")
    parser.add_argument(
        "--resume", type=Path, metavar="DIR", help="go on with the campaign in a folder"
    )
    add_engine_options(parser)
    add_config(parser, "over what the campaign file says")
    add_set(parser, "set one parameter over what the campaign file says")
    parser.add_argument("--flights", type=int, metavar="N", help="so many, whatever the file says")
    parser.add_argument("--seed", type=int, metavar="N", help="this one, whatever the file says")


def run(options: argparse.Namespace) -> int:
    """Fly what is left to fly, tell how it went, and return the exit code."""
    from quad_mpc_ros.analysis.report import PLOTLY_NEEDED
    from quad_mpc_ros.experiments.campaign_report import write_campaign_page
    from quad_mpc_ros.experiments.campaigns.flying import begin, fly_into
    from quad_mpc_ros.experiments.campaigns.results import results_text

    campaign, out = _resumed(options) if options.resume is not None else _new(options)
    with engine_of(options) as engine, results_in(out):
        if options.resume is None:
            begin(campaign, _prepared(out))
        print(
            f"flying {campaign.flights} flights with {engine.workers} workers into {out}",
            file=sys.stderr,
        )
        progress = CountProgress()
        try:
            rows = fly_into(out, campaign, engine, progress.show)
        except KeyboardInterrupt:
            print(f"\nto go on: quad_mpc campaign --resume {out}", file=sys.stderr)
            raise
        finally:
            progress.close()
    print(results_text(out, campaign, rows))
    with results_in(out):
        page = write_campaign_page(out)
    print(f"report   {page or PLOTLY_NEEDED}")
    return 0


def _new(options: argparse.Namespace) -> tuple[Campaign, Path]:
    """Return the campaign that is asked for and where it is to be flown into."""
    if options.file is None:
        raise UserError("FILE: expected a campaign file, or --resume DIR")
    campaign = _read(options)
    out = options.out or default_out(options.file.stem)
    _check_new(out)
    return campaign, out


def _resumed(options: argparse.Namespace) -> tuple[Campaign, Path]:
    """Return the campaign of a folder; refuse to go on with another one."""
    from quad_mpc_ros.experiments.campaigns.campaign_file import campaign_text
    from quad_mpc_ros.experiments.campaigns.flying import campaign_of

    if options.out is not None:
        raise UserError("--out: --resume says where: leave one out")
    campaign = campaign_of(options.resume)
    if options.file is not None:
        asked = campaign_text(_read(options))
        if asked != campaign_text(campaign):
            raise UserError(
                f"--resume: {options.file} is not, or is no longer, the campaign of "
                f"{options.resume}: leave the file out, or begin anew with --out"
            )
    elif options.config or options.assignments or options.flights or options.seed is not None:
        raise UserError("--resume: a campaign goes on as it began: leave the other options out")
    return campaign, options.resume


def _read(options: argparse.Namespace) -> Campaign:
    from quad_mpc_ros.experiments.campaigns.campaign_file import Overrides, read_campaign

    overrides = Overrides(
        config=options.config,
        assignments=options.assignments,
        flights=options.flights,
        seed=options.seed,
    )
    return read_campaign(options.file, overrides)


def _check_new(out: Path) -> None:
    """Refuse a folder that holds something before any worker is asked for."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(
            f"--out: {out} exists and is not overwritten; give a new folder, or go on with "
            f"--resume {out}"
        )


def _prepared(out: Path) -> Path:
    from quad_mpc_ros.experiments.campaigns.flying import HOLDS

    return prepared_out(out, holds=HOLDS)

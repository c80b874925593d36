# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Options and workers of the commands that fly campaigns."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.run_options import add_config, add_out, add_set
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers


def add_campaign_options(parser: argparse.ArgumentParser, kind: str) -> None:
    """Add the file of a campaign or a study, its folder, the workers and the overrides."""
    parser.add_argument(
        "file",
        type=Path,
        nargs="?" if kind == "study" else None,
        metavar="FILE",
        help=f"file or name of a shipped {kind} (docs/howto/campaigns.md)",
    )
    add_out(parser, f"the {kind}; must not contain one yet", "<name of the file>")
    add_engine_options(parser)
    add_config(parser, "that overrides the file")
    add_set(parser, "set one parameter; overrides the file")


def add_engine_options(parser: argparse.ArgumentParser) -> None:
    """Add the choice of workers."""
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="number of processes on this machine (default: one for each processor)",
    )


def engine_of(options: argparse.Namespace) -> LocalWorkers:
    """Return the workers of the options. Raises :class:`UserError` for less than one worker."""
    from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers

    if options.workers is not None and options.workers < 1:
        raise UserError(f"--workers: given {options.workers}, expected a number >= 1")
    return LocalWorkers(options.workers)

"""The options of the commands that fly campaigns: which workers."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.experiments.campaigns.engine import Engine


def add_engine_options(parser: argparse.ArgumentParser) -> None:
    """Add what says who flies."""
    workers = parser.add_mutually_exclusive_group()
    workers.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="so many processes of this machine (default: one for each processor)",
    )
    workers.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="the workers of a Dask cluster, by the address of its scheduler: "
        "tcp://127.0.0.1:8786. Needs Dask: pip install 'quad_mpc_ros[campaign]'",
    )


def engine_of(options: argparse.Namespace) -> Engine:
    """Return the workers that are asked for. Raises :class:`UserError` where there are none."""
    if options.scheduler is not None:
        from quad_mpc_ros.experiments.campaigns.dask_workers import DaskWorkers

        return DaskWorkers(options.scheduler)
    from quad_mpc_ros.experiments.campaigns.local_workers import LocalWorkers

    if options.workers is not None and options.workers < 1:
        raise UserError(f"--workers: given {options.workers}, expected a number >= 1")
    return LocalWorkers(options.workers)

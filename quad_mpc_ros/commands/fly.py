# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc fly``: the four nodes as processes over DDS, from discovery to the summary."""

from __future__ import annotations

import argparse
import os
import sys

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.processes import (
    FlightError,
    NodeProcess,
    require_ros,
    start_all,
    stop_all,
)
from quad_mpc_ros.commands.results import finish
from quad_mpc_ros.commands.run_configuration import RunConfig, run_configuration
from quad_mpc_ros.commands.run_options import add_run_options
from quad_mpc_ros.recordings.repair import repair


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a run over DDS."""
    parser.description = (
        "Start simulator, reference, mpc and recorder as separate ROS 2 processes, fly, stop "
        "them, and write DIR/bag (rosbag2, MCAP), DIR/summary.json, DIR/figures/*.png and "
        "DIR/log. Exit code 0 only for a flight without failsafe, 2 for bad input."
    )
    add_run_options(parser)
    parser.add_argument(
        "--lockstep",
        action="store_true",
        help="step simulated time only after each command: repeatable bit for bit",
    )


def run(options: argparse.Namespace) -> int:
    """Fly, record and evaluate; return the exit code."""
    require_ros("fly", instead=", or fly without ROS: quad_mpc simulate")
    # Other computers on the network fly on their own; set the variable to share the flight.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    config = run_configuration(options, lockstep=options.lockstep)
    try:
        wall_seconds, all_recorded = _fly(config, lockstep=options.lockstep)
    except FlightError as failure:
        print(f"error: {failure}", file=sys.stderr)
        return EXIT_FAILED
    if not all_recorded:
        repair(config.out / "bag")
    code = finish(config.out, wall_seconds=wall_seconds)
    return code if all_recorded else EXIT_FAILED


def _fly(config: RunConfig, *, lockstep: bool) -> tuple[float, bool]:
    """Start the nodes, fly, and stop them.

    Returns the seconds flown on the wall clock, and whether the recorder ended without an error.
    Raises :class:`FlightError`.
    """
    print(f"flying the {config.reference.trajectory} into {config.out}", file=sys.stderr)
    nodes: dict[str, NodeProcess] = {}
    try:
        nodes = start_all(config, lockstep=lockstep)
        # Imported while the nodes start, because both take about as long.
        from quad_mpc_ros.commands.flight_monitor import FlightMonitor, watch_flight

        with FlightMonitor(lockstep=lockstep) as monitor:
            wall_seconds = watch_flight(monitor, nodes, config.simulator.duration)
    finally:
        stop_all(nodes)
    return wall_seconds, nodes["recorder"].exit_code == 0

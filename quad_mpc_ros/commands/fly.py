# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc fly``: the four nodes as processes over DDS, from discovery to the summary."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.fleet import RECORDED, finish_fleet, fleet_configurations
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
from quad_mpc_ros.configuration import UserError
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
    parser.add_argument(
        "--together",
        action="store_true",
        help="run mpc and reference in one process, like stack_node; requires one vehicle",
    )
    parser.add_argument(
        "--vehicles",
        type=int,
        default=1,
        metavar="N",
        help="fly N vehicles at once, 2 m apart, in the namespaces uav1, uav2 and so on, "
        "without figures (default: 1)",
    )
    parser.add_argument(
        "--neighbours",
        action="store_true",
        help="with --vehicles: the vehicles avoid each other, using their published plans; "
        "--obstacles implies it",
    )


def run(options: argparse.Namespace) -> int:
    """Fly, record and evaluate; return the exit code."""
    require_ros("fly", instead=", or fly without ROS: quad_mpc simulate")
    if options.vehicles < 1 or (options.lockstep and options.vehicles > 1):
        raise UserError(
            f"--vehicles: given {options.vehicles}, expected 1 or more, and 1 with --lockstep"
        )
    if options.neighbours and options.vehicles == 1:
        raise UserError("--neighbours: given with --vehicles 1, expected 2 or more")
    if options.together and options.vehicles > 1:
        raise UserError(f"--together: expected --vehicles 1, given {options.vehicles}")
    # Other computers on the network fly on their own; set the variable to share the flight.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if options.vehicles > 1:
        configs = fleet_configurations(options)
    else:
        configs = {"": run_configuration(options, lockstep=options.lockstep)}
    try:
        wall_seconds, all_recorded = _fly(configs, options)
    except FlightError as failure:
        print(f"error: {failure}", file=sys.stderr)
        return EXIT_FAILED
    if not all_recorded:
        for config in configs.values():
            repair(config.out / "bag")
    if options.vehicles > 1:
        code = finish_fleet(configs, wall_seconds=wall_seconds)
    else:
        code = finish(configs[""].out, wall_seconds=wall_seconds)
    return code if all_recorded else EXIT_FAILED


def _fly(configs: Mapping[str, RunConfig], options: argparse.Namespace) -> tuple[float, bool]:
    """Start the nodes of each vehicle, fly, and stop them.

    ``configs`` are the configurations by namespace. Returns the seconds flown on the wall clock,
    and whether all recorders ended without an error. Raises :class:`FlightError`.
    """
    first = next(iter(configs.values()))
    into = first.out if len(configs) == 1 else first.out.parent
    print(f"flying the {first.reference.trajectory} into {into}", file=sys.stderr)
    vehicles: dict[str, dict[str, NodeProcess]] = {}
    try:
        for namespace, config in configs.items():
            vehicles[namespace] = start_all(
                config, lockstep=options.lockstep, namespace=namespace, together=options.together
            )
        # Imported while the nodes start, because both take about as long.
        from quad_mpc_ros.commands.flight_monitor import FlightMonitor, watch_flight

        with FlightMonitor(
            lockstep=options.lockstep,
            namespaces=list(configs),
            recorded=None if len(configs) == 1 else RECORDED,
            together=options.together,
        ) as monitor:
            processes = [each for nodes in vehicles.values() for each in nodes.values()]
            wall_seconds = watch_flight(monitor, processes, first.simulator.duration)
    finally:
        for nodes in vehicles.values():
            stop_all(nodes)
    return wall_seconds, not any(nodes["recorder"].exit_code for nodes in vehicles.values())

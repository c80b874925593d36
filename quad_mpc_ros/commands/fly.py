"""``quad_mpc fly``: the four nodes as processes over DDS, from discovery to the summary."""

from __future__ import annotations

import argparse
import os
import sys
import time
from typing import Any

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.fleet import fly_fleet
from quad_mpc_ros.commands.processes import (
    FlightError,
    NodeProcess,
    require_ros,
    start_all,
    stop_all,
)
from quad_mpc_ros.commands.progress import Progress
from quad_mpc_ros.commands.results import finish
from quad_mpc_ros.commands.run_configuration import RunConfig, run_configuration
from quad_mpc_ros.commands.run_options import add_run_options
from quad_mpc_ros.configuration import UserError

# The first start after an installation compiles, on a small computer for minutes.
_READY_TIMEOUT = 240.0
_PATIENCE = 5.0


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
        help="simulated time that waits for every command: repeatable bit for bit",
    )
    parser.add_argument(
        "--together",
        action="store_true",
        help="mpc and reference in one process, as stack_node does; with one vehicle",
    )
    parser.add_argument(
        "--vehicles",
        type=int,
        default=1,
        metavar="N",
        help="fly N vehicles at once, each in a namespace, uav1 and so on, without figures "
        "(default: 1)",
    )


def run(options: argparse.Namespace) -> int:
    """Fly, record and evaluate; return the exit code."""
    require_ros("fly", instead=", or fly without ROS: quad_mpc simulate")
    if options.vehicles < 1 or (options.lockstep and options.vehicles > 1):
        raise UserError(
            f"--vehicles: given {options.vehicles}, expected 1 or more, and 1 with --lockstep"
        )
    if options.together and options.vehicles > 1:
        raise UserError(f"--together: expected --vehicles 1, given {options.vehicles}")
    # Other machines on the network fly their own; who wants them to hear this sets the variable.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if options.vehicles > 1:
        return fly_fleet(options)
    config = run_configuration(options, lockstep=options.lockstep)
    print(f"flying the {config.reference.trajectory} into {config.out}", file=sys.stderr)
    lockstep, together = options.lockstep, options.together
    processes = start_all(config, lockstep=lockstep, together=together)
    try:
        wall_seconds = _flight(config, processes, lockstep=lockstep, together=together)
    except FlightError as failure:
        stop_all(processes)
        print(f"error: {failure}", file=sys.stderr)
        return EXIT_FAILED
    finally:
        stop_all(processes)
    code = finish(config.out, wall_seconds=wall_seconds)
    return EXIT_FAILED if processes["recorder"].exit_code else code


def _flight(
    config: RunConfig, processes: dict[str, NodeProcess], *, lockstep: bool, together: bool
) -> float:
    """Wait until the nodes hear each other, start the clock, wait for the end.

    Returns the seconds flown on the wall clock. Raises :class:`FlightError`.
    """
    from quad_mpc_ros.commands.flight_monitor import FlightMonitor

    with FlightMonitor(lockstep=lockstep, together=together) as monitor:
        _await_readiness(monitor, processes)
        monitor.start_simulator()
        flying = {node: process for node, process in processes.items() if node != "simulator"}
        started, progress = time.monotonic(), Progress(config.simulator.duration)
        while processes["simulator"].exit_code is None:
            monitor.spin(0.05)
            if progress.due:
                progress.show(*monitor.progress())
            _let_recorder_go(flying)
            _check_alive(flying)
        progress.close()
        if monitor.lost():
            print(f"warning: {monitor.lost()}", file=sys.stderr)
        simulator = processes["simulator"]
        if simulator.exit_code != 0:
            raise FlightError(
                f"the simulator failed (exit code {simulator.exit_code})\n{simulator.last_words()}"
            )
        return time.monotonic() - started


def _await_readiness(monitor: Any, processes: dict[str, NodeProcess]) -> None:
    print("  waiting for the nodes to hear each other", file=sys.stderr, flush=True)
    started = time.monotonic()
    patient = False
    while not monitor.ready():
        _check_alive(processes)
        if monitor.intruders():
            raise FlightError(
                f"{monitor.intruders()}: another flight on this ROS domain; "
                "end it or set ROS_DOMAIN_ID to another number"
            )
        waited = time.monotonic() - started
        if waited > _PATIENCE and not patient:
            patient = True
            print("  the first start compiles, which takes a while", file=sys.stderr, flush=True)
        if waited > _READY_TIMEOUT:
            raise FlightError(
                f"the nodes did not find each other within {_READY_TIMEOUT:g} s, "
                f"missing: {', '.join(monitor.missing())}"
            )
        monitor.spin(0.02)


def _let_recorder_go(flying: dict[str, NodeProcess]) -> None:
    """Fly on without a recorder that has ended, for its disk may be full, and say so."""
    recorder = flying.get("recorder")
    if recorder is not None and recorder.exit_code is not None:
        print(f"\nerror: {recorder.obituary()}\n  the flight goes on", file=sys.stderr, flush=True)
        del flying["recorder"]


def _check_alive(processes: dict[str, NodeProcess]) -> None:
    for process in processes.values():
        if process.exit_code is not None:
            raise FlightError(process.obituary())

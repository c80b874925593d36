"""``quad_mpc fly``: the four nodes as processes over DDS, from discovery to the summary."""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
import time
from typing import Any

from quad_mpc_ros.commands.processes import NodeProcess, start_all, stop_all
from quad_mpc_ros.commands.progress import Progress
from quad_mpc_ros.commands.results import finish
from quad_mpc_ros.commands.run_options import RunConfig, resolve
from quad_mpc_ros.configuration import UserError

EXIT_FAILED = 1
_READY_TIMEOUT = 60.0
_NEEDED = ("rclpy", "nav_msgs", "trajectory_msgs", "diagnostic_msgs", "std_srvs")


class FlightError(Exception):
    """The flight could not start or came to an early end; the message says why."""


def fly(options: argparse.Namespace) -> int:
    """Fly, record and evaluate; return the exit code."""
    _require_ros()
    config = resolve(options, lockstep=options.lockstep)
    # Other machines on the network fly their own; who wants them to hear this sets the variable.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    print(f"flying the {config.reference.trajectory} into {config.out}", file=sys.stderr)
    processes = start_all(config, lockstep=options.lockstep)
    try:
        wall_seconds = _flight(config, processes, lockstep=options.lockstep)
    except FlightError as failure:
        stop_all(processes)
        print(f"error: {failure}", file=sys.stderr)
        return EXIT_FAILED
    finally:
        stop_all(processes)
    return finish(config.out, wall_seconds=wall_seconds)


def _flight(config: RunConfig, processes: dict[str, NodeProcess], *, lockstep: bool) -> float:
    """Wait until the nodes hear each other, start the clock, wait for the end.

    Returns the seconds flown on the wall clock. Raises :class:`FlightError`.
    """
    from quad_mpc_ros.commands.flight_monitor import FlightMonitor

    with FlightMonitor(lockstep=lockstep) as monitor:
        _await_readiness(monitor, processes)
        monitor.start_simulator()
        started, progress = time.monotonic(), Progress(config.simulator.duration)
        while processes["simulator"].exit_code is None:
            monitor.spin(0.05)
            if progress.due:
                progress.show(*monitor.progress())
            _check_alive(processes, but="simulator")
        progress.close()
        _check_end(processes["simulator"])
        return time.monotonic() - started


def _await_readiness(monitor: Any, processes: dict[str, NodeProcess]) -> None:
    print("  waiting for the nodes to hear each other", file=sys.stderr, flush=True)
    deadline = time.monotonic() + _READY_TIMEOUT
    while not monitor.ready():
        _check_alive(processes)
        if monitor.intruders():
            raise FlightError(
                f"{monitor.intruders()}: another flight on this ROS domain; "
                "end it or set ROS_DOMAIN_ID to another number"
            )
        if time.monotonic() > deadline:
            raise FlightError(
                f"the nodes did not find each other within {_READY_TIMEOUT:g} s, "
                f"missing: {', '.join(monitor.missing())}"
            )
        monitor.spin(0.02)


def _check_alive(processes: dict[str, NodeProcess], *, but: str | None = None) -> None:
    for node, process in processes.items():
        if node != but and process.exit_code is not None:
            raise FlightError(
                f"{node} ended by itself (exit code {process.exit_code})\n{process.last_words()}"
            )


def _check_end(simulator: NodeProcess) -> None:
    if simulator.exit_code != 0:
        raise FlightError(
            f"the simulator failed (exit code {simulator.exit_code})\n{simulator.last_words()}"
        )


def _require_ros() -> None:
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(
            f"fly needs ROS 2 Jazzy, not found: {', '.join(missing)}; source an installed ROS 2 "
            "Jazzy, or pip install 'quad_mpc_ros[ros]', or fly without ROS: quad_mpc simulate"
        )

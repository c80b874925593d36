"""Several vehicles at once: each with its nodes in a namespace of its own, one table for all."""

from __future__ import annotations

import argparse
import copy
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.output import default_out, results_in, write_json
from quad_mpc_ros.commands.processes import FlightError, NodeProcess, start_all, stop_all
from quad_mpc_ros.commands.progress import Progress
from quad_mpc_ros.commands.run_configuration import RunConfig, run_configuration
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY, REFERENCE, STATS

# What the table asks for; each more costs a recorder, and a plan that is looked at its MPC.
_RECORDED = (ODOMETRY, REFERENCE, COMMAND, STATS)
_READY_TIMEOUT = 300.0

Fleet = Mapping[str, dict[str, NodeProcess]]


def fly_fleet(options: argparse.Namespace) -> int:
    """Fly ``options.vehicles`` vehicles, record and evaluate each; return the exit code."""
    configs = configurations(options)
    print(f"flying {len(configs)} vehicles", file=sys.stderr)
    fleet: dict[str, dict[str, NodeProcess]] = {}
    try:
        for namespace, config in configs.items():
            fleet[namespace] = start_all(config, lockstep=False, namespace=namespace)
        wall_seconds = _flight(configs, fleet)
    except FlightError as failure:
        print(f"error: {failure}", file=sys.stderr)
        return EXIT_FAILED
    finally:
        for processes in fleet.values():
            stop_all(processes)
    return _finish(configs, wall_seconds=wall_seconds)


def configurations(options: argparse.Namespace) -> dict[str, RunConfig]:
    """Return the configuration of each vehicle by its namespace, their folders made."""
    recorded = ", ".join(topic.name for topic in _RECORDED)
    configs = {}
    out: Path | None = options.out
    for number in range(1, options.vehicles + 1):
        namespace = f"uav{number}"
        given = copy.copy(options)
        given.assignments = [f"recorder.topics=[{recorded}]", *options.assignments]
        if out is None:
            out = default_out("fleet")
        given.out = out / namespace
        configs[namespace] = run_configuration(given, lockstep=False)
    return configs


def _flight(configs: Mapping[str, RunConfig], fleet: Fleet) -> float:
    """Wait until all nodes of each vehicle hear each other, start all clocks, wait for the end.

    Returns the seconds flown on the wall clock. Raises :class:`FlightError`.
    """
    from quad_mpc_ros.commands.flight_monitor import FlightMonitor

    recorded = [topic.name for topic in _RECORDED]
    with FlightMonitor(lockstep=False, namespaces=list(fleet), recorded=recorded) as monitor:
        print("  waiting for the nodes to hear each other", file=sys.stderr, flush=True)
        started = time.monotonic()
        while not monitor.ready():
            _check_alive(fleet)
            if time.monotonic() - started > _READY_TIMEOUT:
                raise FlightError(
                    f"the nodes did not find each other within {_READY_TIMEOUT:g} s, "
                    f"missing: {', '.join(monitor.missing())}"
                )
            monitor.spin(0.02)
        monitor.start_simulator()
        duration = next(iter(configs.values())).simulator.duration
        started, progress = time.monotonic(), Progress(duration)
        while any(processes["simulator"].exit_code is None for processes in fleet.values()):
            monitor.spin(0.05)
            if progress.due:
                progress.show(*monitor.progress())
            _check_alive(fleet, but="simulator")
        progress.close()
        if monitor.lost():
            print(f"warning: {monitor.lost()}", file=sys.stderr)
        return time.monotonic() - started


def _check_alive(fleet: Fleet, *, but: str = "") -> None:
    for namespace, processes in fleet.items():
        for node, process in processes.items():
            if node != but and process.exit_code is not None:
                raise FlightError(f"{namespace}: {process.obituary()}")


def _finish(configs: Mapping[str, RunConfig], *, wall_seconds: float) -> int:
    """Evaluate each vehicle's bag, show one table, and return the exit code."""
    from quad_mpc_ros.recordings.evaluation.metrics import summarise
    from quad_mpc_ros.recordings.recording import Recording

    summaries = {}
    for namespace, config in configs.items():
        summaries[namespace] = summarise(
            Recording(config.out / "bag").flight(), wall_seconds=wall_seconds
        )
        with results_in(config.out):
            write_json(config.out / "summary.json", summaries[namespace])
    print(fleet_table(summaries))
    print(f"\nbags and summaries  {next(iter(configs.values())).out.parent}/uav*")
    held = all(s["commands"] and not s["fallbacks"] for s in summaries.values())
    return 0 if held else EXIT_FAILED


def fleet_table(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a table of vehicles, and of all of them together."""
    rows = [
        ["", "RMSE [m]", "odometry to command p50", "p99", "max [ms]", "late or none", "fallbacks"]
    ]
    asked = late = fallbacks = 0
    for name, summary in summaries.items():
        latency = summary["odom_to_command_ms"]
        missed = summary["deadline_misses"] + summary["unanswered_odometries"]
        asked += summary["commands"] + summary["unanswered_odometries"]
        late, fallbacks = late + missed, fallbacks + summary["fallbacks"]
        rows.append(
            [
                name,
                _shown(summary["position_rmse_m"]),
                *(_shown(latency[key]) for key in ("p50", "p99", "max")),
                str(missed),
                str(summary["fallbacks"]),
            ]
        )
    share = 100.0 * (1.0 - late / max(asked, 1))
    within = f"answered within a period: {share:.2f} % of {asked}, fallbacks: {fallbacks}"
    return "\n".join((*text_table(rows, align="lrrrrrr"), within))


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"

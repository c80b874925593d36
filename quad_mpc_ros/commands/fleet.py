# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Several simulated vehicles at once: configurations by namespace, one table of results."""

from __future__ import annotations

import argparse
import copy
import dataclasses
import sys
from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.output import results_in, write_json
from quad_mpc_ros.commands.run_configuration import HALF_SPACES, RunConfig, run_configuration
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY, REFERENCE, STATS

_SEPARATION = 2.0  # m, of vehicles at the start
RECORDED = tuple(topic.name for topic in (ODOMETRY, REFERENCE, COMMAND, STATS))
"""Recorded topics of each of several vehicles: the topics that the table needs.

Each further topic costs time in a recorder, and plans cost time in an MPC.
"""


def fleet_configurations(options: argparse.Namespace) -> dict[str, RunConfig]:
    """Return the configuration of each vehicle by namespace, and create the folders.

    Raises :class:`UserError` for invalid options.
    """
    configs: dict[str, RunConfig] = {}
    names = [f"uav{number}" for number in range(1, options.vehicles + 1)]
    vehicle_options = copy.copy(options)
    for number, name in enumerate(names):
        y = _SEPARATION * number
        assignments = [
            f"recorder.topics=[{', '.join(RECORDED)}]",
            f"reference.origin=[0.0, {y}]",
        ]
        if options.neighbours or options.obstacles is not None:
            others = ", ".join(other for other in names if other != name)
            assignments += [
                f"mpc.obstacles.neighbours=[{others}]",
                f"mpc.obstacles.half_spaces={HALF_SPACES}",
            ]
        vehicle_options.assignments = [*assignments, *options.assignments]
        config = run_configuration(vehicle_options, lockstep=False, vehicle=name)
        vehicle_options.out = config.out.parent  # one folder for all, also without --out
        simulator = config.simulator
        # Another start is that on the reference, or is configured.
        if simulator.initial_position == (0.0, 0.0, 0.0):
            simulator = dataclasses.replace(simulator, initial_position=(0.0, y, 0.0))
        configs[name] = dataclasses.replace(config, simulator=simulator)
    return configs


def finish_fleet(configs: Mapping[str, RunConfig], *, wall_seconds: float) -> int:
    """Evaluate the bag of each vehicle, print one table, and return the exit code."""
    from quad_mpc_ros.recordings.evaluation.metrics import summarise, with_neighbours
    from quad_mpc_ros.recordings.evaluation.verdict import verdict_on
    from quad_mpc_ros.recordings.recording import Recording

    flights = {name: Recording(config.out / "bag").flight() for name, config in configs.items()}
    summaries = {}
    for namespace, config in configs.items():
        others = [flight for name, flight in flights.items() if name != namespace]
        summaries[namespace] = with_neighbours(
            summarise(flights[namespace], wall_seconds=wall_seconds), flights[namespace], others
        )
        with results_in(config.out):
            write_json(config.out / "summary.json", summaries[namespace])
    print(_fleet_table(summaries))
    print(f"\nbags and summaries  {next(iter(configs.values())).out.parent}/uav*")
    verdicts = {name: verdict_on(summary) for name, summary in summaries.items()}
    failed = [f"{name}: {verdict.line}" for name, verdict in verdicts.items() if not verdict.good]
    print("\n".join(["", *failed]), file=sys.stderr)
    return EXIT_FAILED if failed else 0


def _fleet_table(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a table with a row for each vehicle, and a line for all vehicles."""
    to_command = ("odometry to command p50", "p99", "max [ms]")
    rows = [["", "RMSE [m]", "nearest [m]", *to_command, "late or none", "fallbacks"]]
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
                _shown(summary["clearance_min_m"]),
                *(_shown(latency[key]) for key in ("p50", "p99", "max")),
                str(missed),
                str(summary["fallbacks"]),
            ]
        )
    share = 100.0 * (1.0 - late / max(asked, 1))
    within = f"answered odometries: {share:.2f} % of {asked}, fallbacks: {fallbacks}"
    return "\n".join((*text_table(rows, align="lrrrrrrr"), within))


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"

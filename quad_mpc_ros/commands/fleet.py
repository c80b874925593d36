"""Several vehicles at once: each with its nodes in a namespace, one table for all."""

from __future__ import annotations

import argparse
import copy
import dataclasses
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.output import results_in, write_json
from quad_mpc_ros.commands.run_configuration import HALF_SPACES, RunConfig, run_configuration
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY, REFERENCE, STATS

_MIN_SEPARATION = 2.0  # m, of vehicles at the start
RECORDED = tuple(topic.name for topic in (ODOMETRY, REFERENCE, COMMAND, STATS))
"""Topics that are recorded of each vehicle of a fleet: those that the table needs.

Every further topic costs time of a recorder, and plans that of an MPC.
"""


def fleet_configurations(options: argparse.Namespace) -> dict[str, RunConfig]:
    """Return the configuration of each vehicle by its namespace, their folders made."""
    configs = {}
    recorded = ", ".join(RECORDED)
    out: Path | None = options.out
    for number in range(1, options.vehicles + 1):
        namespace = f"uav{number}"
        given = copy.copy(options)
        keeps_clear = options.neighbours or options.obstacles is not None
        made = [
            f"recorder.topics=[{recorded}]",
            f"reference.origin=[0.0, {_MIN_SEPARATION * (number - 1)}]",
            *(_as_neighbour(options, number) if keeps_clear else ()),
        ]
        given.assignments = [*made, *options.assignments]
        given.out = out
        made_config = run_configuration(given, lockstep=False, vehicle=namespace)
        out = made_config.out.parent
        configs[namespace] = _beside(made_config, number)
    return configs


def _as_neighbour(options: argparse.Namespace, number: int) -> list[str]:
    """Return what makes a vehicle keep clear of the others, as assignments."""
    others = [f"uav{other}" for other in range(1, options.vehicles + 1) if other != number]
    return [
        f"mpc.obstacles.neighbours=[{', '.join(others)}]",
        f"mpc.obstacles.half_spaces={HALF_SPACES}",
    ]


def _beside(config: RunConfig, number: int) -> RunConfig:
    """Return the configuration of a vehicle that starts on the ground beside the others."""
    simulator = config.simulator
    if simulator.initial_position != (0.0, 0.0, 0.0):  # on its reference, or where a file says
        return config
    place = (0.0, _MIN_SEPARATION * (number - 1), 0.0)
    moved = dataclasses.replace(simulator, initial_position=place)
    return dataclasses.replace(config, simulator=moved)


def finish_fleet(configs: Mapping[str, RunConfig], *, wall_seconds: float) -> int:
    """Evaluate each vehicle's bag, show one table, and return the exit code."""
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
    """Return a table of vehicles, and of all of them together."""
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
    within = f"answered within a period: {share:.2f} % of {asked}, fallbacks: {fallbacks}"
    return "\n".join((*text_table(rows, align="lrrrrrrr"), within))


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"

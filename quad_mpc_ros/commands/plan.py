# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc plan``: time-optimal race through gates, as a file to fly."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from quad_mpc_ros.analysis.figures.reference_figure import write_reference
from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.output import check_writable, results_in, write_new
from quad_mpc_ros.commands.run_options import add_config, add_set
from quad_mpc_ros.configuration.arguments import number
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.extras.racing.gates import read_course
from quad_mpc_ros.extras.racing.planning.casadi_module import casadi
from quad_mpc_ros.extras.racing.planning.race_plan import RacePlan, plan_race
from quad_mpc_ros.extras.racing.verdict import VEHICLE_RADIUS
from quad_mpc_ros.recordings.evaluation.simulated import load_config
from quad_mpc_ros.references.feasibility import Feasibility, judged

_LIMIT_MARGIN = 0.05  # share of the range between hover and each limit, left to the controller


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for course, vehicle, output and margins."""
    parser.description = (
        "Plan a time-optimal race through gates within the limits of a vehicle. Writes a table "
        "for reference.file and a figure. Exit code 0 for a plan within the limits, 1 beyond the "
        "limits, 2 for bad input."
    )
    parser.add_argument(
        "gates", metavar="FILE", help="file of gates, or a shipped track: seven_gates, split_s"
    )
    add_config(parser, "of the vehicle (vehicles/cpc, …)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("race.csv"),
        help="table to write (default: race.csv)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")
    parser.add_argument(
        "--gate-margin",
        type=float,
        default=0.1,
        metavar="M",
        help="distance kept from the edges of the gates (default: 0.1 m)",
    )
    parser.add_argument(
        "--radius",
        type=float,
        default=VEHICLE_RADIUS,
        metavar="M",
        help="radius of the vehicle, added to the distance from the frame of an opening (default: "
        f"{VEHICLE_RADIUS:g} m)",
    )
    parser.add_argument(
        "--step",
        type=float,
        default=0.05,
        metavar="S",
        help="longest step between nodes of the plan (default: 0.05 s)",
    )
    add_set(
        parser,
        "set one parameter of mpc, simulator or reference, for example reference.limit_margin "
        f"(default here: {_LIMIT_MARGIN:g})",
    )


def run(options: argparse.Namespace) -> int:
    """Plan, write, draw; return the exit code."""
    # Checked here, so that errors name the options.
    number(options.gate_margin, "--gate-margin", least=0.0, below=100.0)
    number(options.radius, "--radius", least=0.0, below=10.0)
    number(options.step, "--step", above=0.004, below=0.5)
    check_writable("--out", options.out, overwrite=options.overwrite)
    picture = options.out.with_suffix(".png")
    check_writable("--out", picture, overwrite=options.overwrite)
    casadi()  # fails if CasADi is not installed
    course = read_course(options.gates)
    margin = f"reference.limit_margin={_LIMIT_MARGIN}"
    config = load_config(
        *(options.config or ["default"]), assignments=[margin, *options.assignments]
    )
    print(f"planning {course.source}, which takes seconds to minutes", file=sys.stderr)
    started = time.monotonic()
    plan = plan_race(
        course,
        *config,
        gate_margin=options.gate_margin,
        radius=options.radius,
        step=options.step,
    )
    seconds = time.monotonic() - started
    write_new("--out", options.out, plan.table.text(), overwrite=options.overwrite)
    verdict = judged(plan.trajectory(), config.reference)
    with results_in(options.out.parent):
        title = f"{course.source}: {plan.lap.time or plan.race_time:.2f} s"
        write_reference(title, verdict, picture, course=course)
    print(_table(plan, verdict, seconds=seconds))
    print(f"\nplan     {options.out}\npicture  {picture}")
    return 0 if verdict.feasible else EXIT_FAILED


def _table(plan: RacePlan, verdict: Feasibility, *, seconds: float) -> str:
    facts = [
        ("lap", f"{plan.lap.time or 0.0:.3f} s, at rest after {plan.nodes.times[-1]:.3f} s"),
        ("planned in", f"{seconds:.1f} s, {plan.iterations} iterations"),
        ("highest speed", f"{verdict.over_time.speed.max():.2f} m/s"),
        ("needs", "within the limits" if verdict.feasible else verdict.reason()),
    ]
    rows: list[Sequence[str]] = [("", "time", "from centre")]
    for gate, passage in zip(plan.course.numbers, plan.lap.passages, strict=True):
        if passage.time is None or passage.miss is None:
            rows.append((f"gate {gate}", "-", "-"))
        else:
            rows.append((f"gate {gate}", f"{passage.time:.3f} s", f"{passage.miss:.3f} m"))
    lines = text_table(facts, align="ll")
    return "\n".join((*lines, "", *text_table(rows, align="lrr")))

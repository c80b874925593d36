# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc check-reference``: compare a reference with the limits of the vehicle."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence

from quad_mpc_ros.analysis.figures.reference_figure import write_reference
from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.output import create_out, prepared_out, results_in
from quad_mpc_ros.commands.run_configuration import reference_assignments
from quad_mpc_ros.commands.run_options import add_configuration_options, add_out
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.recordings.evaluation.simulated import load_config
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import judged_trajectory
from quad_mpc_ros.references.feasibility import Feasibility, rates_beyond

_FIGURE_NAME = "reference.png"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the reference, the vehicle and the output."""
    parser.description = (
        "Print and draw throttle, body rates and height of a whole reference against the limits "
        "of the vehicle. Exit code 0 if it is feasible, 1 if not, 2 for bad input."
    )
    add_configuration_options(parser)
    add_out(parser, f"{_FIGURE_NAME}; must not contain one yet", "<reference>")


def run(options: argparse.Namespace) -> int:
    """Evaluate, print and draw the reference; return the exit code."""
    assignments = [*reference_assignments(options), *options.assignments]
    loaded = load_config(*(options.config or ["default"]), assignments=assignments)
    config = _within_the_mpc(loaded.reference, loaded.mpc)
    _, verdict = judged_trajectory(config)
    out = prepared_out(options.out or create_out(config.trajectory), holds=(_FIGURE_NAME,))
    figure = out / _FIGURE_NAME
    course = None
    if config.gates:
        from quad_mpc_ros.extras.racing.gates import read_course

        course = read_course(config.gates)
    with results_in(out):
        write_reference(config.trajectory, verdict, figure, course=course)
    print(f"{config.trajectory}\n\n{_verdict_table(verdict)}")
    for need, bound in rates_beyond(verdict, loaded.mpc.omega_max):
        print(
            f"note: {need.name} {need.worst:.4g} rad/s is beyond mpc.omega_max, {bound:.4g}: the "
            "MPC cannot track it exactly"
        )
    print(f"\nfigure  {figure}")
    return 0 if verdict.feasible else EXIT_FAILED


def _within_the_mpc(reference: ReferenceConfig, mpc: MpcConfig) -> ReferenceConfig:
    """Return the reference with the bounds of the MPC where these are tighter."""
    omega_max = map(min, reference.omega_max, mpc.omega_max)
    return dataclasses.replace(
        reference,
        throttle_min=max(reference.throttle_min, mpc.throttle_min),
        throttle_max=min(reference.throttle_max, mpc.throttle_max),
        omega_max=tuple(omega_max),
    )


def _verdict_table(verdict: Feasibility) -> str:
    """Return the verdict as lines of plain ASCII text, at most 80 columns wide."""
    over_time = verdict.over_time
    facts = [
        ("duration", f"{over_time.seconds[-1]:.2f} s"),
        ("highest speed", f"{over_time.speed.max():.2f} m/s"),
        ("highest acceleration", f"{over_time.acceleration.max():.2f} m/s^2"),
    ]
    needs: list[Sequence[str]] = [("", "", "needed", "at", "limit", "left")]
    for need in verdict.needs:
        values = (f"{value:.3f}" for value in (need.limit, need.margin))
        needs.append(
            (need.name, need.unit.strip(), f"{need.worst:.3f}", f"{need.time:.3f} s", *values)
        )
    return "\n".join(
        (
            *text_table(facts, align="ll"),
            "",
            *text_table(needs, align="llrrrr"),
            "",
            "feasible" if verdict.feasible else f"not feasible: {verdict.reason()}",
        )
    )

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc rehearse``: find the errors of a vehicle file that the MPC tolerates."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.campaign_options import add_engine_options, engine_of
from quad_mpc_ros.commands.output import create_out, prepared_out, results_in
from quad_mpc_ros.commands.run_options import add_config, add_controller, add_out, add_set

if TYPE_CHECKING:
    from quad_mpc_ros.extras.campaigns.rehearsal import Rehearsal

LOST = "lost"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the vehicle, the output and the workers."""
    parser.description = (
        "Hover simulated vehicles in gusts and with noisy odometry; they start moving and "
        "tilted, next to the reference. Then increase lags, delay, mass and thrust errors until "
        "a vehicle does not recover. Prints the margins and a verdict. Exit code 0 for ready, 1 "
        "for marginal or not ready, 2 for bad input."
    )
    add_config(parser, "(default, agile, …, your vehicle file)")
    add_set(parser, "set one parameter, for example mpc.horizon_steps=20")
    add_controller(parser)
    add_out(
        parser,
        f"{LOST}/, files of vehicles that did not recover; must not contain it yet",
        "rehearsal",
    )
    add_engine_options(parser)


def run(options: argparse.Namespace) -> int:
    """Rehearse and print the result; return the exit code."""
    from quad_mpc_ros.commands.progress import ProgressLine
    from quad_mpc_ros.extras.campaigns.rehearsal import (
        READY,
        VEHICLES,
        disturbed_campaign,
        rehearsal_table,
        rehearse,
        verdict_on,
    )

    config, progress = options.config or ["default"], ProgressLine()
    disturbed_campaign(config, options.assignments)  # fails for an invalid configuration
    with engine_of(options) as engine:
        out = prepared_out(options.out or create_out("rehearsal"), holds=(LOST,))
        print(f"rehearsing with {VEHICLES} disturbed vehicles into {out}", file=sys.stderr)
        found = rehearse(config, options.assignments, engine, progress.show)
        progress.close()
    with results_in(out):
        again = _write_lost(out, found)
        if found.limits:
            print(f"{rehearsal_table(found)}\n")
    verdict = verdict_on(found)
    print(f"verdict  {verdict.word}")
    print("\n".join(f"why      {each}" for each in verdict.reasons))
    print("\n".join(f"to do    {each}" for each in verdict.advice))
    if again is not None:
        print(f"\nlost     quad_mpc simulate --config {again}")
    return 0 if verdict.word == READY else EXIT_FAILED


def _write_lost(out: Path, found: Rehearsal) -> Path | None:
    """Write a parameter file of a crashed vehicle for each direction.

    Returns the file of the direction with the smallest margin, None without a crash.
    """
    lost = {"as guessed": next(iter(found.lost), None)}
    tightest_first = sorted(found.limits, key=lambda each: each.margin / each.direction.ready)
    lost |= {limit.direction.name: limit.lost for limit in tightest_first}
    written = []
    for name, flown in lost.items():
        if flown is not None:
            (out / LOST).mkdir(exist_ok=True)
            path = out / LOST / f"{name.replace(' ', '_')}.yaml"
            path.write_text(flown.parameter_file, encoding="utf-8")
            written.append(path)
    return written[0] if written else None

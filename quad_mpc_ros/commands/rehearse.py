"""``quad_mpc rehearse``: how wrong may the guess of a vehicle be before it does not come back?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.campaign_options import add_engine_options, engine_of
from quad_mpc_ros.commands.output import create_out, prepared_out, results_in, write_json
from quad_mpc_ros.commands.run_options import add_config, add_out, add_set

if TYPE_CHECKING:
    from quad_mpc_ros.extras.campaigns.rehearsal.rehearsal import Rehearsal

RESULT, PICTURE, LOST = "rehearsal.json", "rehearsal.png", "lost"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the vehicle, where to write, the workers."""
    parser.description = (
        "Hover simulated vehicles that begin beside the reference, pushed and tilted, in gusts "
        "and with noisy odometry; then let them lag more, answer later, push less or more and "
        "weigh more than guessed, until one does not come back. Prints the margins and a verdict. "
        "Exit code 0 for ready, 1 for marginal or not ready, 2 for bad input."
    )
    add_config(parser, "(default, agile, …, your vehicle file)")
    add_set(parser, "set one parameter, for example mpc.horizon_steps=20")
    add_out(parser, f"{RESULT}, {PICTURE} and {LOST}/; must not hold any", "rehearsal")
    add_engine_options(parser)


def run(options: argparse.Namespace) -> int:
    """Rehearse, show and draw; return the exit code."""
    from quad_mpc_ros.commands.progress import ProgressLine
    from quad_mpc_ros.extras.campaigns.rehearsal.figure import write_rehearsal
    from quad_mpc_ros.extras.campaigns.rehearsal.rehearsal import (
        VEHICLES,
        disturbed_campaign,
        rehearse,
    )
    from quad_mpc_ros.extras.campaigns.rehearsal.verdict import (
        READY,
        rehearsal_figures,
        rehearsal_table,
        verdict_on,
    )

    config, progress = options.config or ["default"], ProgressLine()
    disturbed_campaign(config, options.assignments)  # what is wrong in it is said before all else
    with engine_of(options) as engine:
        out = prepared_out(options.out or create_out("rehearsal"), holds=(RESULT, PICTURE, LOST))
        print(f"rehearsing with {VEHICLES} disturbed vehicles into {out}", file=sys.stderr)
        found = rehearse(
            config,
            options.assignments,
            engine,
            lambda text: progress.show(text) if progress.due else None,
        )
        progress.close()
    with results_in(out):
        write_json(out / RESULT, rehearsal_figures(found))
        again = _write_lost(out, found)
        if found.limits:
            write_rehearsal(out / PICTURE, found)
            print(f"{rehearsal_table(found)}\n")
    verdict = verdict_on(found)
    print(f"verdict  {verdict.word}")
    print("\n".join(f"why      {each}" for each in verdict.reasons))
    print("\n".join(f"to do    {each}" for each in verdict.advice))
    print(f"\nresult   {out / RESULT}")
    if found.limits:
        print(f"picture  {out / PICTURE}")
    if again is not None:
        print(f"lost     quad_mpc simulate --config {again}")
    return 0 if verdict.word == READY else EXIT_FAILED


def _write_lost(out: Path, found: Rehearsal) -> Path | None:
    """Write a parameter file of a lost vehicle of each direction, and return the most telling.

    That is the one of the direction that has the least of what it needs.
    """
    lost = {"as guessed": next(iter(found.guess.lost), None)}
    tightest_first = sorted(found.limits, key=lambda each: each.margin / each.direction.ready)
    lost |= {limit.direction.name: limit.first_lost for limit in tightest_first}
    written = []
    for name, flown in lost.items():
        if flown is not None:
            (out / LOST).mkdir(exist_ok=True)
            path = out / LOST / f"{name.replace(' ', '_')}.yaml"
            path.write_text(flown.parameter_file, encoding="utf-8")
            written.append(path)
    return written[0] if written else None

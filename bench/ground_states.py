# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Count the states of the ground in the flights of campaigns, none of which touches it.

python bench/ground_states.py hover lemniscate --flights 250 --duration 6

A flight counts as far as its vehicle is truly in the air. docs/explanation/landing_detection.md.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.extras.campaigns.campaign import FlightPlan
from quad_mpc_ros.extras.campaigns.campaign_file import located_campaign, read_campaign
from quad_mpc_ros.simulation.closed_loop import fly

_AIRBORNE = 0.02  # m


def states_of(plan: FlightPlan, *, duration: float) -> Counter[str]:
    """Fly for a duration [s], and return the number of each state in the air."""
    mpc, simulator, reference = plan.config
    simulator = replace(simulator, duration=min(duration, simulator.duration))
    steps = fly(mpc=mpc, simulator=simulator, reference=reference, trajectory=plan.trajectory)
    return Counter(
        step.tick.stats.ground
        for step in steps
        if step.tick is not None and step.truth.p_WB[2] > _AIRBORNE
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, and print the counts; exit code 1 if one in the air counted as on the ground."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("campaigns", nargs="+", help="names of shipped campaigns, or files")
    parser.add_argument("--flights", type=int, default=500, help="of each campaign")
    parser.add_argument("--duration", type=float, default=12.0, help="of a flight [s]")
    options = parser.parse_args(arguments)
    total: Counter[str] = Counter()
    for name in options.campaigns:
        campaign, counted = read_campaign(located_campaign(Path(name))), Counter[str]()
        for number in range(options.flights):
            counted += states_of(campaign.plan(number), duration=options.duration)
            if number % 10 == 9:
                print(f"{name} {number + 1}: {dict(counted)}", file=sys.stderr, flush=True)
        print(f"{name}: {dict(counted)}")
        total += counted
    wrong = total[GroundState.ON_GROUND.value] + total[GroundState.CRASHED.value]
    print(f"in the air, and taken for standing or lying: {wrong} of {total.total()}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Race the Split-S of CPC with deviating vehicles: contouring compared with plain tracking.

    python bench/contouring.py --flights 50

Each flight has a mass within 10 % of the planned one, wind of 3 m/s from anywhere, 10 ms more
delay than modelled, and unmodelled drag of 0.15 kg/s, half of what such a vehicle has.
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from quad_mpc_ros import load_config, plan_race, simulate, summarise

VEHICLE, COURSE = "vehicles/cpc", "split_s"
_MASS, _WIND, _DELAY, _DRAG = 0.1, 3.0, 0.01, 0.15
_GATE_MARGIN = 0.1  # m


def changes(seed: int) -> list[str]:
    """Return the parameters of the plant of a flight, those of the planned one without a seed."""
    random = np.random.default_rng(seed)
    mass = 1.0 + random.uniform(-_MASS, _MASS)
    wind = random.standard_normal(3)
    wind *= _WIND / np.linalg.norm(wind)
    return [
        f"simulator.mass_scale={mass}",
        f"simulator.command_delay={_DELAY}",
        f"simulator.wind={wind.tolist()}",
        f"simulator.airframe.drag_linear={[_DRAG] * 3}",
    ]


def flown(formulation: str, trajectory: Any, assignments: list[str]) -> dict[str, Any]:
    """Return the figures of a flight."""
    config = load_config(
        VEHICLE,
        assignments=[
            f"mpc.formulation={formulation}",
            f"reference.gates={COURSE}",
            f"mpc.gates={COURSE}",
            "simulator.duration=24.0",
            *assignments,
        ],
    )
    return summarise(simulate(*config, trajectory=trajectory, on_reference=True))


def print_row(name: str, flights: list[dict[str, Any]]) -> None:
    """Print a line with the statistics of some flights."""
    gates = [sum(gate["passed"] for gate in flight["gates"]) for flight in flights]
    laps = [flight["lap_time_s"] for flight in flights if flight["lap_time_s"] is not None]
    misses = [
        gate["miss_m"]
        for flight in flights
        for gate in flight["gates"]
        if gate["passed"] and gate["miss_m"] is not None
    ]
    steps = [flight["step_time_us"] for flight in flights]
    print(
        f"{name:10s} all gates in {sum(n == 19 for n in gates)} of {len(flights)}, fewest "
        f"{min(gates)}; lap p50 {np.median(laps) if laps else math.nan:.2f} s, most "
        f"{max(laps, default=math.nan):.2f} s; farthest from a centre {max(misses):.3f} m; "
        f"iterations p99 {max(flight['iterations']['p99'] for flight in flights)}, failed "
        f"{sum(flight['solver_failures'] for flight in flights)}, "
        f"step p50 {np.median([step['p50'] for step in steps]):.0f} us, p99 "
        f"{np.median([step['p99'] for step in steps]):.0f} us",
        flush=True,
    )


def main() -> None:
    """Plan, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--margin", type=float, default=0.05, help="left to the controller")
    options = parser.parse_args()
    config = load_config(VEHICLE, assignments=[f"reference.limit_margin={options.margin}"])
    plan = plan_race(COURSE, *config, gate_margin=_GATE_MARGIN)
    print(f"planned {plan.race_time:.2f} s")
    seeds = range(options.first, options.first + options.flights)
    for formulation in ("manifold", "contouring"):
        print_row(formulation, [flown(formulation, plan.trajectory(), [])])
    flights: dict[str, list[dict[str, Any]]] = {"manifold": [], "contouring": []}
    for seed in seeds:  # by turns, so that their times compare
        for formulation, done in flights.items():
            done.append(flown(formulation, plan.trajectory(), changes(seed)))
    for formulation, done in flights.items():
        if done:
            print_row(formulation, done)


if __name__ == "__main__":
    main()

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Measure how much faster than real time the closed loop runs in one process, by part.

python bench/closed_loop.py [--duration S] [--repeats N] [--only FLIGHT ...]

Flies each flight in turns and takes the shortest time of each part, since what else the machine
does only adds to it. *fly* is `simulation/closed_loop.py` `fly`, start and references included;
*whole* is `simulate` and `summarise`, as a campaign flies. A step is an odometry with what follows
from it: the MPC, the controller around it, and the rest of *fly* (plant, sensors, reference).
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import NamedTuple

from peers.controller import ControllerPeer
from performance import TimedPeer

from quad_mpc_ros import simulate, summarise
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig, load_config
from quad_mpc_ros.simulation.closed_loop import fly

_EFFECTS = (
    "simulator.rate_time_constant=0.03",
    "simulator.thrust_time_constant=0.03",
    "simulator.command_delay=0.02",
    "mpc.rate_time_constant=0.03",
    "mpc.thrust_time_constant=0.03",
    "mpc.input_delay=0.02",
    "simulator.gust_intensity=1.0",
    "simulator.position_noise=0.01",
    "simulator.attitude_noise=0.005",
    "simulator.velocity_noise=0.02",
    "simulator.rate_noise=0.01",
)
FLIGHTS = {
    "hover": ("reference.trajectory=hover",),
    "square": ("reference.trajectory=square",),
    "lemniscate": ("reference.trajectory=lemniscate",),
    "hover, all effects": ("reference.trajectory=hover", *_EFFECTS),
    "hover, all effects, 200 Hz": (
        "reference.trajectory=hover",
        *_EFFECTS,
        "simulator.odom_rate=200.0",
    ),
}


class Times(NamedTuple):
    """Times of a flight [s]: ``fly``, the controller in it, and the MPC in the controller."""

    fly: float
    controller: float
    mpc: float
    whole: float


def timed(config: FlightConfig) -> tuple[Times, int]:
    """Fly three times: as it is, with the controller timed, and whole; and count the steps."""
    mpc, simulator, reference = config
    started = time.perf_counter()
    steps = sum(1 for _ in fly(mpc=mpc, simulator=simulator, reference=reference))
    flown = time.perf_counter() - started
    law = TimedPeer(ControllerPeer(mpc))
    for _ in fly(simulator=simulator, reference=reference, controller=law):
        pass
    controller = 1e-6 * sum(law.step_us)
    solving = sum(effort.mpc_time or 0.0 for effort in law.efforts)
    started = time.perf_counter()
    summarise(simulate(mpc, simulator, reference))
    whole = time.perf_counter() - started
    return Times(fly=flown, controller=controller, mpc=solving, whole=whole), steps


def measured(config: FlightConfig, *, repeats: int) -> tuple[Times, int]:
    """Return the shortest time of each part, and the number of steps."""
    flights = [timed(config) for _ in range(repeats)]
    shortest = map(min, zip(*(times for times, _ in flights), strict=True))
    return Times(*shortest), flights[0][1]


def main() -> int:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=10.0, help="of each flight [s]")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", nargs="+", choices=FLIGHTS, default=[*FLIGHTS])
    options = parser.parse_args()
    rows = [["flight", "fly", "whole", "step [us]", "MPC", "controller", "the rest", "log"]]
    duration = options.duration
    for name in options.only:
        assignments = [*FLIGHTS[name], "mpc.lockstep=true", f"simulator.duration={duration}"]
        config = load_config("default", assignments=assignments)
        rows.append([name, *cells(*measured(config, repeats=options.repeats), duration=duration)])
    print("\n".join(text_table(rows, align="lrrrrrrr")))
    return 0


def cells(times: Times, steps: int, *, duration: float) -> list[str]:
    """Return the real time factor of a flight of ``duration`` [s], and the parts of a step."""
    parts = (
        times.fly,
        times.mpc,
        times.controller - times.mpc,
        times.fly - times.controller,
        times.whole - times.fly,
    )
    return [
        *(f"{duration / seconds:.0f} x" for seconds in (times.fly, times.whole)),
        *(f"{1e6 * seconds / steps:.0f}" for seconds in parts),
    ]


if __name__ == "__main__":
    sys.exit(main())

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Measure the cost of a campaign without its flights: distribution, results, table.

python bench/campaign_cost.py [--workers N] [--flights N]

Flies many flights of one step, of which little is left but what is asked for, and subtracts what
as many take in this process. *Once* is what it takes until each worker has flown one: processes
that start, imports, compiled code that is loaded. Both are printed as shares of a campaign of 500
hover flights of 12 s, of which some are flown in this process, as well. All is processor time, of
every process that takes part, so that other work on the machine does not count.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from quad_mpc_ros.commands.campaign_options import add_engine_options, engine_of
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.campaign_file import campaign_from
from quad_mpc_ros.extras.campaigns.flight import fly_batch
from quad_mpc_ros.extras.campaigns.flying import begin, fly_into
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers

_STEP, _WHOLE = 0.02, 12.0  # s of flight
_USUAL = 500  # flights of a campaign
_OWN = 5  # whole flights that are timed
_VARY: dict[str, Any] = {
    "simulator.rate_time_constant": {"uniform": [0.02, 0.08]},
    "simulator.thrust_scale": {"uniform": [0.95, 1.05]},
    "simulator.wind": {"uniform": [[-1, -1, -1], [1, 1, 1]]},
    "simulator.seed": {"integers": [0, 1_000_000]},
}


def campaign(*, flights: int, duration: float, vary: dict[str, Any]) -> Campaign:
    """Return hover flights of some duration [s]."""
    content = {"flights": flights, "reference": "hover", "duration": duration, "vary": vary}
    return campaign_from(content)


def own_seconds(duration: float, *, flights: int) -> float:
    """Return the processor time [s] of a flight of a duration [s] in this process."""
    vary = _VARY if duration == _STEP else {}
    flown = campaign(flights=3 * flights, duration=duration, vary=vary)
    fly_batch(flown, [0])  # loads compiled code
    taken = []
    for turn in range(3):  # others each time, for text made of the same values is kept
        started = time.process_time()
        fly_batch(flown, range(turn * flights, (turn + 1) * flights))
        taken.append(time.process_time() - started)
    return min(taken) / flights


def used_seconds() -> float:
    """Return the processor time [s] of this process and of those it ended."""
    while multiprocessing.active_children():
        time.sleep(0.01)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def engine_seconds(options: argparse.Namespace, *, flights: int) -> tuple[int, float, float]:
    """Return the number of workers, and what it takes until each has flown, and ``flights`` more.

    The latter is processor time [s], with that of the table: of all, and of this process for the
    ``flights`` alone.
    """
    before = used_seconds()
    with tempfile.TemporaryDirectory() as folder, engine_of(options) as engine:
        workers = engine.workers
        fly_in(Path(folder) / "first", engine, flights=workers)
        started = time.process_time()
        if flights:
            fly_in(Path(folder) / "many", engine, flights=flights)
        here = time.process_time() - started
    return workers, used_seconds() - before, here


def fly_in(folder: Path, engine: LocalWorkers, *, flights: int) -> None:
    """Fly a campaign of flights of one step into a new folder."""
    folder.mkdir()
    flown = campaign(flights=flights, duration=_STEP, vary=_VARY)
    begin(flown, folder)
    fly_into(folder, flown, engine)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_engine_options(parser)
    parser.add_argument("--flights", type=int, default=2000, help="of one step each")
    options = parser.parse_args()
    short, whole = own_seconds(_STEP, flights=200), own_seconds(_WHOLE, flights=_OWN)
    workers, once, _ = engine_seconds(options, flights=0)
    _, all_of_it, here = engine_seconds(options, flights=options.flights)
    each = (all_of_it - once) / options.flights - short
    print(f"{workers} workers")
    print(f"own time of a flight of one step  {1e3 * short:8.2f} ms")
    print(f"own time of a flight of 12 s      {1e3 * whole:8.2f} ms")
    print(f"a campaign costs each flight      {1e3 * each:8.2f} ms   {each / whole:.2%}")
    here /= options.flights
    print(f"  of it in this process           {1e3 * here:8.2f} ms   {here / whole:.2%}")
    share = once / (_USUAL * whole)
    print(f"and once                          {1e3 * once:8.2f} ms   {share:.2%} of {_USUAL}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

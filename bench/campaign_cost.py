"""What a campaign costs beside its flights: handing them out, taking their results, the table.

python bench/campaign_cost.py [--workers N | --scheduler ADDRESS] [--flights N]

Flies many flights of one step, of which little is left but what is asked for, and subtracts what
as many take in this process. *Once* is what remains of the first flight: processes that start,
imports, compiled code that is loaded. Both are told as shares of a campaign of 500 hover flights
of 12 s, of which some are flown in this process, as well.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from quad_mpc_ros.campaigns.campaign import Campaign
from quad_mpc_ros.campaigns.campaign_file import campaign_from
from quad_mpc_ros.campaigns.engine import Engine
from quad_mpc_ros.campaigns.flight import fly_batch
from quad_mpc_ros.campaigns.flying import begin, fly_into
from quad_mpc_ros.commands.engines import add_engine_options, engine_of

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


def seconds(act: Callable[[], object]) -> float:
    """Return how long it takes [s]."""
    started = time.perf_counter()
    act()
    return time.perf_counter() - started


def own_seconds(duration: float, *, flights: int) -> float:
    """Return what a flight of some duration [s] takes by itself, in this process [s]."""
    vary = _VARY if duration == _STEP else {}
    flown = campaign(flights=flights, duration=duration, vary=vary)
    fly_batch(flown, [0])  # loads compiled code
    return min(seconds(lambda: fly_batch(flown, range(flights))) for _ in range(3)) / flights


def engine_seconds(make_engine: Callable[[], Engine], *, flights: int) -> tuple[float, float]:
    """Return the time until each worker has flown, and then that of many flights [s]."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, make_engine() as engine:
        fly_in(Path(folder) / "first", engine, flights=engine.workers)
        first = time.perf_counter() - started
        return first, seconds(lambda: fly_in(Path(folder) / "many", engine, flights=flights))


def fly_in(folder: Path, engine: Engine, *, flights: int) -> None:
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
    workers = []

    def make_engine() -> Engine:
        engine = engine_of(options)
        workers.append(engine.workers)
        return engine

    short, whole = own_seconds(_STEP, flights=200), own_seconds(_WHOLE, flights=_OWN)
    first, many = engine_seconds(make_engine, flights=options.flights)
    cores = min(workers[0], len(os.sched_getaffinity(0)))
    # Of the processors that fly, each flight has had its share.
    cost = cores * many / options.flights - short
    print(f"{workers[0]} workers on {cores} processors")
    print(f"own time of a flight of one step  {1e3 * short:8.2f} ms")
    print(f"own time of a flight of 12 s      {1e3 * whole:8.2f} ms")
    print(f"a campaign costs each flight      {1e3 * cost:8.2f} ms   {cost / whole:.2%}")
    share = cores * first / (_USUAL * whole)
    print(f"and once                          {1e3 * first:8.2f} ms   {share:.2%} of {_USUAL}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""All peers flown in turn: what disturbs the machine for a while hits all of them alike."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from quad_mpc_ros.bench import machine
from quad_mpc_ros.bench.config import BenchConfig, Entry
from quad_mpc_ros.bench.figures import summarise
from quad_mpc_ros.bench.flight import MeasuredFlight, fly
from quad_mpc_ros.bench.peer import PeerUnavailableError
from quad_mpc_ros.bench.peers import PEERS
from quad_mpc_ros.bench.preparation import NewPeer, prepare

Tell = Callable[[str], None]
"""Shows one line of progress."""


def run(config: BenchConfig, *, scratch: Path, tell: Tell) -> dict[str, Any]:
    """Fly everything and return what was measured, as JSON knows it.

    ``scratch`` is a folder for what has to be compiled. A peer that cannot fly here is told and
    listed under ``skipped``.
    """
    described = machine.describe()
    ready, skipped = _prepared(config, scratch, tell)
    flights: dict[Entry, list[MeasuredFlight]] = {entry: [] for entry in ready}
    order = list(_order(list(ready), config.repeats))
    for number, entry in enumerate(order, start=1):
        flight = fly(ready[entry](), simulator=config.simulator, reference=config.reference)
        flights[entry].append(flight)
        tell(
            f"flight {number} of {len(order)}: {PEERS[entry.peer].title}, N = {entry.steps}: "
            f"{len(flight.step_us)} steps in {1e-6 * flight.step_us.sum():.2f} s"
        )
    return {
        "machine": described,
        "settings": _settings(config),
        "skipped": skipped,
        "entries": [
            {"peer": entry.peer, "horizon_steps": entry.steps, **summarise(flown)}
            for entry, flown in flights.items()
        ],
    }


def _prepared(
    config: BenchConfig, scratch: Path, tell: Tell
) -> tuple[dict[Entry, NewPeer], dict[str, str]]:
    """Return how to make each peer, and why some cannot be made."""
    ready: dict[Entry, NewPeer] = {}
    skipped: dict[str, str] = {}
    for entry in config.entries():
        if entry.peer in skipped:
            continue
        mpc = dataclasses.replace(config.mpc, horizon_steps=entry.steps)
        try:
            ready[entry] = prepare(entry.peer, mpc, scratch / f"{entry.peer}_{entry.steps}")
        except PeerUnavailableError as error:
            skipped[entry.peer] = str(error)
            tell(f"skipped: {PEERS[entry.peer].title}: {error}")
    return {entry: new for entry, new in ready.items() if entry.peer not in skipped}, skipped


def _order(flying: Sequence[Entry], repeats: int) -> Iterator[Entry]:
    """Yield the entries ``repeats`` times, every second time backwards."""
    for repeat in range(repeats):
        yield from flying if repeat % 2 == 0 else reversed(flying)


def _settings(config: BenchConfig) -> dict[str, Any]:
    mpc = config.mpc
    return {
        "duration_s": config.simulator.duration,
        "repeats": config.repeats,
        "trajectory": config.reference.trajectory,
        "dynamics": config.simulator.dynamics,
        "odom_rate_hz": config.simulator.odom_rate,
        "horizon_steps": mpc.horizon_steps,
        "horizon_step_s": mpc.horizon_step,
        "Q": list(mpc.Q),
        "R": list(mpc.R),
        "terminal_weight": mpc.terminal_weight,
        "solver_tolerance": mpc.solver.tolerance,
    }

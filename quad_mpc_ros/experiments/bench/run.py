"""All peers flown in turns, so that a disturbance of the machine affects all of them alike."""

from __future__ import annotations

import dataclasses
import datetime
import importlib.metadata
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.experiments.bench.flights import MeasuredFlight, fly, summarise
from quad_mpc_ros.experiments.bench.peers import NewPeer, PeerKind, PeerUnavailableError
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.config import SimulatorConfig


@dataclass(frozen=True, kw_only=True)
class BenchConfig:
    """The peers at ``mpc.horizon_steps``, and some of them at each of ``steps``, in turns."""

    mpc: MpcConfig
    simulator: SimulatorConfig
    reference: ReferenceConfig
    peers: Mapping[str, PeerKind]
    steps: Sequence[int]
    repeats: int

    def entries(self) -> list[Entry]:
        """Return everything that is to fly, each once."""
        compared = [Entry(peer, self.mpc.horizon_steps) for peer in self.peers]
        lengths = [peer for peer, kind in self.peers.items() if kind.swept]
        swept = [Entry(peer, steps) for steps in self.steps for peer in lengths]
        return list(dict.fromkeys(compared + swept))


@dataclass(frozen=True)
class Entry:
    """One line of the result: a peer with a horizon of ``steps``."""

    peer: str
    steps: int


Report = Callable[[str], None]
"""Shows one line of progress."""


def run(config: BenchConfig, *, scratch: Path, report: Report) -> dict[str, Any]:
    """Fly everything and return what was measured, as JSON knows it.

    ``scratch`` is a folder for what has to be compiled. A peer that cannot fly here is reported
    and listed under ``skipped``.
    """
    described = describe_machine([d for kind in config.peers.values() for d in kind.distributions])
    ready, skipped = _prepared(config, scratch, report)
    flights: dict[Entry, list[MeasuredFlight]] = {entry: [] for entry in ready}
    order = list(_order(list(ready), config.repeats))
    for number, entry in enumerate(order, start=1):
        flight = fly(ready[entry](), simulator=config.simulator, reference=config.reference)
        flights[entry].append(flight)
        title = config.peers[entry.peer].title
        report(
            f"flight {number} of {len(order)}: {title}, N = {entry.steps}: "
            f"{len(flight.step_us)} steps in {1e-6 * flight.step_us.sum():.2f} s"
        )
    return {
        "machine": described,
        "settings": _settings(config),
        "peers": {name: _described(kind) for name, kind in config.peers.items()},
        "skipped": skipped,
        "entries": [
            {"peer": entry.peer, "horizon_steps": entry.steps, **summarise(flown)}
            for entry, flown in flights.items()
        ],
    }


def _prepared(
    config: BenchConfig, scratch: Path, report: Report
) -> tuple[dict[Entry, NewPeer], dict[str, str]]:
    """Return how to make each peer, and why some cannot be made."""
    ready: dict[Entry, NewPeer] = {}
    skipped: dict[str, str] = {}
    for entry in config.entries():
        if entry.peer in skipped:
            continue
        mpc = dataclasses.replace(config.mpc, horizon_steps=entry.steps)
        try:
            folder = scratch / f"{entry.peer}_{entry.steps}"
            ready[entry] = config.peers[entry.peer].make(mpc, folder)
        except PeerUnavailableError as error:
            skipped[entry.peer] = str(error)
            report(f"skipped: {config.peers[entry.peer].title}: {error}")
    return {entry: new for entry, new in ready.items() if entry.peer not in skipped}, skipped


def _order(flying: Sequence[Entry], repeats: int) -> Iterator[Entry]:
    """Yield the entries ``repeats`` times, every second time backwards."""
    for repeat in range(repeats):
        yield from flying if repeat % 2 == 0 else reversed(flying)


def _described(kind: PeerKind) -> dict[str, Any]:
    return {
        "title": kind.title,
        "solver": kind.solver,
        "description": kind.description,
        "swept": kind.swept,
    }


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


_DISTRIBUTIONS = ("numpy", "scipy", "osqp")


def describe_machine(distributions: Sequence[str]) -> dict[str, str]:
    """Return processor, system and versions by name; unknown ones are left out."""
    found = {
        "date": datetime.date.today().isoformat(),
        "processor": _processor(),
        "cores": str(os.cpu_count() or ""),
        "load before the run": f"{os.getloadavg()[0]:.2f}",
        "system": _system(),
        "kernel": platform.release().partition("-")[0],
        "Python": platform.python_version(),
    }
    for name in (*_DISTRIBUTIONS, *distributions):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {name: text for name, text in found.items() if text}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()


def _system() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        return platform.system()

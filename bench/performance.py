# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Measure the time of a control step, next to other controllers and OSQP alone.

python bench/performance.py              # prints the tables
python bench/performance.py --publish    # renews bench/performance.json and the page
python bench/performance.py --page       # renews the page from the figures recorded last

Flies the square on the true rigid body with each peer of ``bench/peers`` in turns, in one process;
then this controller and acados with other lengths of the horizon. A peer that cannot fly here is
skipped. ``--config`` and ``--set`` change the parameters of all peers.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime
import gc
import importlib.metadata
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import performance_page
from numpy.typing import NDArray
from peers import acados, controller, cvxpy
from peers.peer import Effort, NewPeer, Peer, PeerKind, PeerUnavailableError

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig, load_config
from quad_mpc_ros.simulation import closed_loop

ROOT = Path(__file__).resolve().parents[1]
RECORD, PAGE = ROOT / "bench" / "performance.json", ROOT / "docs/measurements/performance.md"
PEERS: dict[str, PeerKind] = {
    "controller": controller.CONTROLLER,
    "acados": acados.PEER,
    "paper": controller.PAPER,
    "cvxpy": cvxpy.PEER,
}
# The peers model no lags, no delay and no disturbance.
IDEAL = (
    "mpc.formulation=manifold",
    "mpc.estimate_disturbance=false",
    "mpc.input_delay=0",
    "simulator.command_delay=0",
    *(
        f"{node}.{lag}=0"
        for node in ("mpc", "simulator")
        for lag in ("rate_time_constant", "thrust_time_constant")
    ),
    *(f"{node}.lockstep=true" for node in ("mpc", "simulator", "reference")),
)
Job = tuple[str, int]
"""A peer and the length of its horizon."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredFlight:
    """A flight step by step.

    ``step_us`` (n,): odometry and reference in to command out [us]. ``solve_us`` (n,): the
    solver's own time [us]. ``mpc_us`` (n,): the MPC alone [us], NaN where it is the whole step.
    ``iterations``, ``solved`` (n,). ``errors`` (n,): of the true position [m].
    """

    step_us: Array
    solve_us: Array
    mpc_us: Array
    iterations: NDArray[np.int64]
    solved: NDArray[np.bool_]
    errors: Array


class TimedPeer:
    """A peer as a control law, each step timed."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self.step_us: list[float] = []
        self.efforts: list[Effort] = []

    def __call__(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the command that answers an odometry."""
        started_ns = time.perf_counter_ns()
        command = self._peer.step(odometry, window)
        self.step_us.append(1e-3 * (time.perf_counter_ns() - started_ns))
        self.efforts.append(self._peer.effort())
        return command


def fly(peer: Peer, config: FlightConfig) -> MeasuredFlight:
    """Fly a peer in the closed loop; garbage of earlier flights is collected first."""
    law = TimedPeer(peer)
    gc.collect()
    _, simulator, reference = config
    steps = closed_loop.fly(simulator=simulator, reference=reference, controller=law)
    errors = [np.linalg.norm(step.truth.p_WB - step.window.p_WB[0]) for step in steps]
    return MeasuredFlight(
        step_us=np.array(law.step_us),
        solve_us=1e6 * np.array([effort.solve_time for effort in law.efforts]),
        mpc_us=1e6 * np.array([effort.mpc_time for effort in law.efforts], dtype=np.float64),
        iterations=np.array([effort.iterations for effort in law.efforts], dtype=np.int64),
        solved=np.array([effort.solved for effort in law.efforts], dtype=np.bool_),
        errors=np.array(errors),
    )


def summarise(flights: Sequence[MeasuredFlight]) -> dict[str, Any]:
    """Return the figures of one peer's flights, all of their steps taken together.

    Times leave out the first step of each flight, on which solvers set themselves up; the longest
    of those is ``first_step_us``. The RMSE is that of the worst flight. Figures without data are
    None.
    """

    def together(figure: str, *, first: int = 0) -> Array:
        parts = [getattr(flight, figure)[first:] for flight in flights]
        return np.concatenate(parts).astype(np.float64)

    return {
        "flights": len(flights),
        "steps": sum(len(flight.step_us) for flight in flights),
        "failed_steps": int(sum(np.sum(~flight.solved) for flight in flights)),
        "step_us": percentiles(together("step_us", first=1), 50, 99),
        "solve_us": percentiles(together("solve_us", first=1), 50, 99),
        "mpc_us": percentiles(together("mpc_us", first=1), 50, 99),
        "first_step_us": max(float(flight.step_us[0]) for flight in flights),
        "iterations": percentiles(together("iterations"), 50, 99),
        "position_rmse_m": max(float(np.sqrt(np.mean(flight.errors**2))) for flight in flights),
    }


def measure(config: FlightConfig, *, lengths: Sequence[int], repeats: int) -> dict[str, Any]:
    """Fly every peer ``repeats`` times, every second time in reverse order; return the record."""
    machine = describe_machine()
    own = config[0].horizon_steps
    jobs = [(name, own) for name in PEERS]
    jobs += [(name, n) for n in lengths for name, kind in PEERS.items() if kind.swept and n != own]
    with tempfile.TemporaryDirectory(prefix="quad_mpc_bench_") as scratch:
        ready = _made(jobs, config, Path(scratch))
        flights: dict[Job, list[MeasuredFlight]] = {job: [] for job in ready}
        for repeat in range(repeats):
            for job in list(ready)[:: 1 if repeat % 2 == 0 else -1]:
                print(f"{job[0]}, N = {job[1]}", file=sys.stderr, flush=True)
                flights[job].append(fly(ready[job](), config))
    return {
        "machine": machine,
        "settings": _settings(config, repeats),
        "entries": [
            {"peer": name, "horizon_steps": steps, **summarise(flown)}
            for (name, steps), flown in flights.items()
        ],
    }


def _made(jobs: Sequence[Job], config: FlightConfig, scratch: Path) -> dict[Job, NewPeer]:
    """Return the constructors of the available peers."""
    ready: dict[Job, NewPeer] = {}
    skipped: set[str] = set()
    for name, steps in jobs:
        if name in skipped:
            continue
        mpc = dataclasses.replace(config[0], horizon_steps=steps)
        try:
            ready[name, steps] = PEERS[name].make(mpc, scratch / f"{name}_{steps}")
        except PeerUnavailableError as error:
            skipped.add(name)
            print(f"skipped: {PEERS[name].title}: {error}", file=sys.stderr)
    return ready


def _settings(config: FlightConfig, repeats: int) -> dict[str, Any]:
    mpc, simulator, reference = config
    return {
        "duration_s": simulator.duration,
        "repeats": repeats,
        "trajectory": reference.trajectory,
        "dynamics": simulator.dynamics,
        "odom_rate_hz": simulator.odom_rate,
        "horizon_steps": mpc.horizon_steps,
        "horizon_step_s": mpc.horizon_step,
        "Q": list(mpc.Q),
        "R": list(mpc.R),
        "terminal_weight": mpc.terminal_weight,
        "solver_tolerance": mpc.solver.tolerance,
    }


def describe_machine() -> dict[str, str]:
    """Return processor, system and versions by name; unknown ones are left out."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    found = {
        "date": datetime.date.today().isoformat(),
        "processor": models[0] if models else platform.machine(),
        "cores": str(os.cpu_count() or ""),
        "load before the run": f"{os.getloadavg()[0]:.2f}",
        "system": f"{platform.system()} {platform.release().partition('-')[0]}",
        "Python": platform.python_version(),
    }
    packages = (kind.package for kind in PEERS.values() if kind.package is not None)
    for name in ("numpy", "scipy", "osqp", *packages):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def page_of_record() -> str:
    """Return the page of the measurements recorded last."""
    return performance_page.page(json.loads(RECORD.read_text(encoding="utf-8")), PEERS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print, or publish; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=10.0, help="of each flight [s]")
    parser.add_argument("--repeats", type=int, default=2, help="flights of each peer")
    parser.add_argument(
        "--steps", nargs="*", type=int, default=[5, 10, 20, 40], help="lengths of the horizon"
    )
    parser.add_argument("--config", nargs="+", default=["agile"], metavar="FILE")
    parser.add_argument("--set", nargs="+", default=[], metavar="NODE.PARAM=VALUE")
    parser.add_argument("--publish", action="store_true", help="renew record and page")
    parser.add_argument("--page", action="store_true", help="renew the page from the record")
    options = parser.parse_args(arguments)
    if not options.page:
        try:
            assignments = [*IDEAL, f"simulator.duration={options.duration}", *options.set]
            config = load_config(*options.config, assignments=assignments)
        except UserError as error:
            parser.error(str(error))
        record = measure(config, lengths=options.steps, repeats=options.repeats)
        print(performance_page.tables(record, PEERS))
        if not options.publish:
            return 0
        RECORD.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    PAGE.write_text(page_of_record(), encoding="utf-8")
    print(f"{PAGE.relative_to(ROOT)} is renewed")
    return 0


if __name__ == "__main__":
    sys.exit(main())

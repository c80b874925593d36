"""A flight of a peer in the closed loop, every step measured, and its figures of merit."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.experiments.bench.peers import Peer
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS
from quad_mpc_ros.simulation.sensors import OdometryStream


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredFlight:
    """A flight step by step.

    ``step_us`` (n,): odometry and reference in to command out [us]. ``solve_us`` (n,): the
    solver's own time [us]. ``mpc_us`` (n,): the MPC alone [us], NaN where it is the whole step.
    ``iterations``, ``solved`` (n,). ``commands`` (n, 4): throttle and body rates, NaN where there
    was none. ``p_WB`` and ``p_reference`` (n, 3): true and wanted [m].
    """

    step_us: Array
    solve_us: Array
    mpc_us: Array
    iterations: NDArray[np.int64]
    solved: NDArray[np.bool_]
    commands: Array
    p_WB: Array
    p_reference: Array


def fly(peer: Peer, *, simulator: SimulatorConfig, reference: ReferenceConfig) -> MeasuredFlight:
    """Fly a peer through the loop of :func:`quad_mpc_ros.simulation.closed_loop.fly`.

    Garbage of earlier flights is collected first; the collector stays on, as in the node.
    """
    plant, server = make_plant(simulator), ReferenceServer(reference)
    stream = OdometryStream(plant, simulator, start_stamp_ns=SIMULATION_START_NS)
    server.start(SIMULATION_START_NS)
    times, efforts, commands, positions, wanted = [], [], [], [], []
    gc.collect()
    while (sent := stream.step()) is not None:
        window = server.window(sent.odometry.stamp_ns)
        started_ns = time.perf_counter_ns()
        command = peer.step(sent.odometry, window)
        times.append(time.perf_counter_ns() - started_ns)
        efforts.append(peer.effort())
        if command is not None:
            plant.apply(command)
            commands.append([command.throttle, *command.w_WB_B])
        else:
            commands.append([np.nan] * 4)
        positions.append(sent.truth.p_WB)
        wanted.append(window.p_WB[0])
    return MeasuredFlight(
        step_us=1e-3 * np.array(times),
        solve_us=1e6 * np.array([effort.solve_time for effort in efforts]),
        mpc_us=1e6 * np.array([effort.mpc_time for effort in efforts], dtype=np.float64),
        iterations=np.array([effort.iterations for effort in efforts], dtype=np.int64),
        solved=np.array([effort.solved for effort in efforts], dtype=np.bool_),
        commands=np.array(commands),
        p_WB=np.array(positions),
        p_reference=np.array(wanted),
    )


_SMALLEST_JUMP = 0.01  # m; a smooth reference moves less between two odometries at rest

Figures = dict[str, Any]


def summarise(flights: Sequence[MeasuredFlight]) -> Figures:
    """Return the figures of one peer's flights, all of their steps taken together.

    Times leave out the first step of each flight, on which solvers set themselves up; the longest
    of those is ``first_step_us``. Iterations are of every step. Flying quality is that of the
    worst flight. What there is no data for is None, the MPC alone where it is the whole step.
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
        "position_rmse_m": max(
            float(np.sqrt(np.mean(_position_errors(flight) ** 2))) for flight in flights
        ),
        "error_before_switch_m": max(
            (error for flight in flights for error in errors_before_switches(flight)), default=None
        ),
    }


def errors_before_switches(flight: MeasuredFlight) -> list[float]:
    """Return the position error [m] at the last odometry before each jump of the reference."""
    jumps = np.linalg.norm(np.diff(flight.p_reference, axis=0), axis=1) > _SMALLEST_JUMP
    return [float(error) for error in _position_errors(flight)[:-1][jumps]]


def _position_errors(flight: MeasuredFlight) -> Array:
    return np.asarray(np.linalg.norm(flight.p_reference - flight.p_WB, axis=1))

"""The figures of merit of measured flights, as plain numbers that JSON can hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.bench.flight import MeasuredFlight
from quad_mpc_ros.lie import Array

_SMALLEST_JUMP = 0.01  # m; a smooth reference moves less between two odometries at rest

Figures = dict[str, Any]


def summarise(flights: Sequence[MeasuredFlight]) -> Figures:
    """Return the figures of one peer's flights, all of their steps taken together.

    Times leave out the first step of each flight, on which solvers set themselves up; the longest
    of those is ``first_step_us``. Iterations are of every step. Flying quality is that of the
    worst flight. What there is no data for is None, the MPC alone where it is the whole step.
    """
    return {
        "flights": len(flights),
        "steps": sum(len(flight.step_us) for flight in flights),
        "failed_steps": int(sum(np.sum(~flight.solved) for flight in flights)),
        "step_us": _percentiles(np.concatenate([flight.step_us[1:] for flight in flights])),
        "solve_us": _percentiles(np.concatenate([flight.solve_us[1:] for flight in flights])),
        "mpc_us": _percentiles(_known(np.concatenate([flight.mpc_us[1:] for flight in flights]))),
        "first_step_us": max(float(flight.step_us[0]) for flight in flights),
        "iterations": _percentiles(np.concatenate([flight.iterations for flight in flights])),
        "position_rmse_m": max(_rmse(flight) for flight in flights),
        "error_before_switch_m": max(
            (error for flight in flights for error in errors_before_switches(flight)), default=None
        ),
    }


def errors_before_switches(flight: MeasuredFlight) -> list[float]:
    """Return the position error [m] at the last odometry before each jump of the reference."""
    jumps = np.linalg.norm(np.diff(flight.p_reference, axis=0), axis=1) > _SMALLEST_JUMP
    return [float(error) for error in _position_errors(flight)[:-1][jumps]]


def _rmse(flight: MeasuredFlight) -> float:
    return float(np.sqrt(np.mean(_position_errors(flight) ** 2)))


def _position_errors(flight: MeasuredFlight) -> Array:
    return np.asarray(np.linalg.norm(flight.p_reference - flight.p_WB, axis=1))


def _known(values: Array) -> Array:
    return np.asarray(values[~np.isnan(values)])


def _percentiles(values: NDArray[Any]) -> dict[str, float | None]:
    """Return median, 99th percentile and maximum; each is a value that was measured."""
    if len(values) == 0:
        return {"p50": None, "p99": None, "max": None}
    p50, p99 = np.percentile(values, (50, 99), method="inverted_cdf")
    return {"p50": float(p50), "p99": float(p99), "max": float(values.max())}

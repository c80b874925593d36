# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One flight of a campaign, from its number to its row of the table.

The outcome follows from the true states: crash, settled error, tilt.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import files
from quad_mpc_ros.extras.campaigns.campaign import SCHEMA, Campaign, FlightPlan
from quad_mpc_ros.extras.campaigns.table import NUMBER, VERDICT, Row
from quad_mpc_ros.recordings.evaluation.crash import (
    crash_figures,
    crash_of,
    tilts,
    was_airborne,
)
from quad_mpc_ros.recordings.evaluation.metrics import Summary, position_errors, summarise
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig, FlightLog
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.simulation.closed_loop import fly

FIGURES = (
    "settled_error_mean_m",
    "settled_error_max_m",
    "tilt_max_rad",
    "settled_tilt_max_rad",
    "speed_max_m_s",
    "altitude_min_m",
    "rates_rms_rad_s",
)
_SUMMARY_KEYS = (
    "duration_s",
    "odometries",
    "commands",
    "unanswered_odometries",
    "position_rmse_m",
    "position_max_m",
    "attitude_rmse_rad",
    "solver_failures",
    "fallbacks",
    "deadline_misses",
    "estimate_resets",
    "rejected_inputs",
    "rate_saturation_fraction",
    "clearance_min_m",
    "collided",
    "lap_time_s",
    "progress_delay_max_s",
)
_ITERATION_KEYS = ("p50", "p99", "max")


def figures_of(flight: Flight, *, settle_time: float) -> dict[str, float | None]:
    """Return the values of :data:`FIGURES`; ``settled`` figures start at a time [s]."""
    settled = flight.time >= settle_time
    error, tilt = position_errors(flight)[settled], tilts(flight.q_WB_xyzw)
    flown = flight.p_WB[was_airborne(flight.p_WB), 2]
    values = (
        float(error.mean()) if len(error) else None,
        float(error.max()) if len(error) else None,
        float(tilt.max()),
        float(tilt[settled].max()) if len(error) else None,
        float(np.linalg.norm(flight.v_WB_B, axis=1).max()),
        float(flown.min()) if len(flown) else None,
        float(np.sqrt(np.mean(np.sum(flight.w_WB_B**2, axis=1)))),
    )
    return dict(zip(FIGURES, values, strict=True))


@dataclass(frozen=True, kw_only=True)
class FlownFlight:
    """The result of a flight: its row, and the parameter file that repeats the flight."""

    row: Row
    parameter_file: str


def column_names(campaign: Campaign) -> list[str]:
    """Return the columns of a campaign's table."""
    iterations = [f"iterations.{name}" for name in _ITERATION_KEYS]
    figures = [*_SUMMARY_KEYS, *iterations, "waypoint_error_max_m", *FIGURES]
    return [NUMBER, *campaign.columns, *VERDICT, *figures]


def fly_batch(campaign: Campaign, numbers: Sequence[int]) -> list[FlownFlight]:
    """Fly some flights of a campaign, in a worker."""
    return [fly_one(campaign, number) for number in numbers]


def fly_one(campaign: Campaign, number: int) -> FlownFlight:
    """Fly one flight of a campaign; an exception is reported in its row."""
    row: dict[str, Any] = {NUMBER: number, "crashed": False}
    parameter_file = ""
    try:
        drawn = campaign.drawn(number)
        row.update(campaign.cells(drawn))
        parameter_file = _parameter_file(campaign.configured(drawn))
        plan = campaign.plan(number)
        parameter_file = _parameter_file(plan.config)
        row.update(_figures(plan, settle_time=campaign.settle_time))
    except Exception as error:  # the campaign continues
        row["error"] = " ".join(f"{type(error).__name__}: {error}".split())
    return FlownFlight(row=row, parameter_file=parameter_file)


def _figures(plan: FlightPlan, *, settle_time: float) -> dict[str, Any]:
    """Fly, and return the columns of the crash and the figures."""
    mpc, simulator, reference = plan.config
    log = FlightLog(mpc)
    for step in fly(mpc=mpc, simulator=simulator, reference=reference, trajectory=plan.trajectory):
        log.take(step)
    flight = log.flight(plan.config)
    truth = log.with_truth(flight)
    figures = {**_scalars(summarise(flight)), **figures_of(truth, settle_time=settle_time)}
    finite = {
        name: value if value is not None and math.isfinite(value) else None
        for name, value in figures.items()
    }
    return {**crash_figures(crash_of(truth)), **finite}


def _scalars(summary: Summary) -> dict[str, Any]:
    """Return the scalars of a summary, without wall-clock times, which are not repeatable."""
    return {
        **{name: summary[name] for name in _SUMMARY_KEYS},
        **{f"iterations.{name}": summary["iterations"][name] for name in _ITERATION_KEYS},
        "waypoint_error_max_m": max(summary["waypoint_error_m"], default=None),
    }


def _parameter_file(config: FlightConfig) -> str:
    """Return all parameters as a ROS parameter file."""
    lines: list[str] = []
    for node, each in zip(SCHEMA, config, strict=True):
        lines += [f"{node}:", "  ros__parameters:"]
        lines += [
            f"    {name}: {_value_text(value)}"
            for name, value in each.flattened().items()
            if value != ()  # ROS cannot infer its type
        ]
    return "\n".join([*lines, ""])


# Most values are the same in each flight. Formatting them again would dominate the cost.
_value_text = functools.lru_cache(maxsize=4096, typed=True)(files.value_text)

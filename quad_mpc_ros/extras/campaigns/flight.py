# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One flight of a campaign, from its number to its row of the table.

The outcome follows from the true states: crash, settled error, tilt.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import files
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.campaigns.campaign import SCHEMA, Campaign, FlightPlan
from quad_mpc_ros.extras.campaigns.table import NUMBER, VERDICT, Row
from quad_mpc_ros.recordings.evaluation.crash import Crash, TrackedMotion, crash_figures, tilts
from quad_mpc_ros.recordings.evaluation.metrics import Summary, summarise
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig, FlightLog
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.surroundings import Collision

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


@dataclass(kw_only=True)
class TruthLog:
    """The true states of a flight at each odometry, with the reference."""

    stamps_ns: list[int] = field(default_factory=list)
    rows: list[Array] = field(default_factory=list)
    behind: list[float] = field(default_factory=list)
    collision: Collision | None = None

    def take(self, step: LoopStep) -> None:
        """Add a step."""
        truth, window = step.truth, step.window
        self.collision = step.collision
        self.stamps_ns.append(truth.stamp_ns)
        self.rows += (truth.p_WB, truth.v_WB_B, truth.w_WB_B, truth.q_WB_xyzw)
        self.rows += (window.p_WB[0], window.q_WB_xyzw[0])
        before = self.behind[-1] if self.behind else 0.0
        self.behind.append(before if step.tick is None else step.tick.behind)

    def truth(self) -> Truth:
        """Return the states as arrays."""
        stamps_ns = np.array(self.stamps_ns, dtype=np.int64)
        rows = np.concatenate(self.rows).reshape(len(stamps_ns), -1)
        p, v, w, q, p_reference, q_reference = np.split(rows, [3, 6, 9, 13, 16], axis=1)
        motion = TrackedMotion(
            time=1e-9 * (stamps_ns - stamps_ns[0]),
            p_WB=p,
            tilt=tilts(q),
            p_WB_reference=p_reference,
            tilt_reference=tilts(q_reference),
        )
        motion = motion.late(np.array(self.behind))
        return Truth(motion=motion, v_WB_B=v, w_WB_B=w, collision=self.collision)


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """True states at n odometries: the motion, ``v_WB_B`` [m/s] and ``w_WB_B`` [rad/s] (n, 3).

    ``collision`` is the collision that ended the flight, if any.
    """

    motion: TrackedMotion
    v_WB_B: Array
    w_WB_B: Array
    collision: Collision | None = None

    def crash(self) -> Crash | None:
        """Return the first crash, if any."""
        found = [self.motion.crash()]
        if self.collision is not None:
            found.append(Crash(kind="obstacle", time=self.collision.time))
        return min(filter(None, found), key=lambda crash: crash.time, default=None)

    def figures(self, *, settle_time: float) -> dict[str, float | None]:
        """Return the values of :data:`FIGURES`; ``settled`` figures start at a time [s]."""
        motion = self.motion
        settled = motion.time >= settle_time
        error = np.linalg.norm(motion.p_WB_reference - motion.p_WB, axis=1)[settled]
        speed = np.linalg.norm(self.v_WB_B, axis=1)
        flown = motion.p_WB[motion.was_airborne(), 2]
        values = (
            float(error.mean()) if len(error) else None,
            float(error.max()) if len(error) else None,
            float(motion.tilt.max()),
            float(motion.tilt[settled].max()) if len(error) else None,
            float(speed.max()),
            float(flown.min()) if len(flown) else None,
            float(np.sqrt(np.mean(np.sum(self.w_WB_B**2, axis=1)))),
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
    truth_log, flight_log = TruthLog(), FlightLog(mpc)
    for step in fly(mpc=mpc, simulator=simulator, reference=reference, trajectory=plan.trajectory):
        truth_log.take(step)
        flight_log.take(step)
    truth = truth_log.truth()
    figures = {
        **_scalars(summarise(flight_log.flight(plan.config))),
        **truth.figures(settle_time=settle_time),
    }
    finite = {
        name: value if value is not None and math.isfinite(value) else None
        for name, value in figures.items()
    }
    return {**crash_figures(truth.crash()), **finite}


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

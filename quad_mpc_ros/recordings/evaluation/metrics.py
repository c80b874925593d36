# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The figures of merit of a flight: the content of ``summary.json``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from quad_mpc_ros.configuration.arguments import instance, number
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.recordings.evaluation.commanding import (
    FALLBACKS,
    commanding,
    estimated,
    margins,
)
from quad_mpc_ros.recordings.evaluation.crash import collision_of, crash_figures, crash_of
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles
from quad_mpc_ros.recordings.evaluation.race import race_figures
from quad_mpc_ros.recordings.evaluation.task import task_figures
from quad_mpc_ros.recordings.evaluation.waypoints import waypoints
from quad_mpc_ros.recordings.flight import Flight

NOT_FAILED = ["solved", "not run"]
_COUNTERS = ("estimate_resets", "rejected_inputs", "stage_errors")  # of mpc/stats, until the end
_SATURATION_TOLERANCE = 1e-3  # rad/s: rates closer to a bound are saturated
_DEADLINE_TOLERANCE = 0.4  # of a control period: as much as the controller itself forgives

Summary = dict[str, Any]


def summarise(flight: Flight, *, wall_seconds: float | None = None) -> Summary:
    """Return the figures of merit of a flight, as in ``summary.json``.

    Among them ``position_rmse_m``, the root mean square of |p_r - p| over all odometries;
    ``odometry_gaps_s``, starts and ends of gaps in the odometry; ``waypoint_error_m``, just before
    each jump of the reference; ``attitude_rmse_rad``, of the angle |Log(R' R_r)|; ``step_time_us``
    and ``iterations`` as percentiles; ``fallbacks``, the commands of other sources than the MPC;
    ``crashed``, with ``crash`` and ``crash_time_s``, as in a campaign but from the odometry, None
    without a reference; ``clearance_min_m``, from the vehicle's surface to the nearest obstacle's,
    ``collided``, and ``collision`` with its time, place and speed, None if obstacles are unknown;
    ``gates`` and ``lap_time_s`` of a course, see :mod:`quad_mpc_ros.recordings.evaluation.race`;
    ``missed``, tasks that were not completed, and ``beyond_limits``, excesses of the reference
    over limits of the MPC; ``progress_delay_max_s``, the largest delay behind the reference's
    clock with formulation contouring, None with other formulations.

    Args:
        flight: A recorded or simulated flight.
        wall_seconds: Wall-clock duration of the flight [s], if known.

    Raises:
        ArgumentError: An argument has the wrong type.

    Returns:
        Values for strict JSON: missing data are None, never NaN.

    Example:
        >>> summarise(simulate(duration=1.0))["fallbacks"]
        0
    """
    instance(flight, "flight", Flight)
    if wall_seconds is not None:
        wall_seconds = number(wall_seconds, "wall_seconds")
    position_error = position_errors(flight)
    ran = flight.stats["solver_status"] != "not run"
    latency_ms = _latencies_ms(flight)
    duration, race = float(flight.time[-1]), race_figures(flight)
    return {
        "duration_s": duration,
        "odometries": len(flight.stamp_ns),
        "commands": len(flight.commands.stamp_ns),
        "unanswered_odometries": _unanswered(flight),
        "odometry_gaps_s": [list(gap) for gap in flight.gaps],
        "rejected_odometries": dict(flight.rejected),
        "position_rmse_m": _rms(position_error),
        "position_max_m": _number(position_error.max(initial=-math.inf)),
        "waypoint_error_m": [
            float(position_error[waypoint.last])
            for waypoint in waypoints(flight)
            if waypoint.complete
        ],
        "attitude_rmse_rad": _rms(attitude_errors(flight)),
        "step_time_us": percentiles(flight.stats["step_time_us"][ran], 50, 90, 99),
        "solve_time_us": percentiles(flight.stats["solve_time_us"][ran], 50, 90, 99),
        "odom_to_command_ms": percentiles(latency_ms, 50, 90, 99),
        "iterations": percentiles(flight.stats["iterations"][ran], 50, 99),
        "solver_failures": int(np.sum(~np.isin(flight.stats["solver_status"], NOT_FAILED))),
        "fallbacks": int(np.sum(np.isin(flight.stats["source"], FALLBACKS))),
        "deadline_misses": int(np.sum(latency_ms > 1e3 / flight.mpc.control_rate)),
        "rate_saturation_fraction": _saturation(flight),
        **_crash(flight),
        **_obstacles(flight),
        **race,
        **task_figures(flight, race),
        "progress_delay_max_s": _behind(flight),
        **{name: int(flight.stats[name][-1:].sum()) for name in _COUNTERS},
        "commanding": commanding(flight),
        "margins": margins(flight),
        "estimated": estimated(flight),
        "realtime_factor": duration / wall_seconds if wall_seconds else None,
        "config": {node: _plain(values) for node, values in flight.parameters.items()},
    }


def position_errors(flight: Flight) -> Array:
    """Return |p_r - p| at each odometry (n,) [m], relative to the active reference.

    Empty without a reference.
    """
    followed = flight.followed
    if followed is None:
        return np.zeros(0)
    return np.asarray(np.linalg.norm(followed.p_WB - flight.p_WB, axis=1))


def attitude_errors(flight: Flight) -> Array:
    """Return the angle from attitude to reference at each odometry (n,) [rad]."""
    followed = flight.followed
    if followed is None:
        return np.zeros(0)
    R_BW = np.swapaxes(so3.rotation_from_quaternion_xyzw(flight.q_WB_xyzw), -1, -2)
    return np.asarray(np.linalg.norm(so3.log(R_BW @ followed.R_WB), axis=1))


def _behind(flight: Flight) -> float | None:
    """Return the largest delay of the vehicle behind its reference [s]."""
    behind = flight.stats["progress_delay_s"]
    gives_way = flight.mpc.formulation == "contouring" and len(behind) > 0
    return float(behind.max()) if gives_way else None


def _crash(flight: Flight) -> dict[str, Any]:
    """Return whether and how the vehicle crashed, None if unknown."""
    figures = crash_figures(crash_of(flight))
    return figures if flight.reference is not None else dict.fromkeys(figures)


def _obstacles(flight: Flight) -> dict[str, Any]:
    """Return the clearance to obstacles, None if unknown, and the collision, if any."""
    clearance, into = flight.clearance, collision_of(flight)
    collision = None
    if into is not None:
        collision = {
            "time_s": float(flight.time[into]),
            "position_m": flight.p_WB[into].tolist(),
            "speed_m_s": float(np.linalg.norm(flight.v_WB_B[into])),
        }
    return {
        "clearance_min_m": None if clearance is None else _number(clearance.min()),
        "collided": None if clearance is None else into is not None,
        "collision": collision,
    }


def _latencies_ms(flight: Flight) -> Array:
    """Return the time from each odometry to its command, by publish times."""
    _, odometry, command = np.intersect1d(
        flight.stamp_ns, flight.commands.stamp_ns, assume_unique=True, return_indices=True
    )
    sent_ns, received_ns = flight.commands.publish_time_ns, flight.publish_time_ns
    return np.asarray((sent_ns[command] - received_ns[odometry]) * 1e-6)


def _unanswered(flight: Flight) -> int:
    """Count the odometries without a due command, from the first command on.

    Between two commands, or after the last, one more command is due per further control period
    (within half an odometry period), but at most one per odometry.
    """
    answered = np.flatnonzero(np.isin(flight.stamp_ns, flight.commands.stamp_ns))
    if len(answered) == 0:
        return 0
    rate = flight.mpc.control_rate
    periods = flight.time * rate
    slack = min(_DEADLINE_TOLERANCE, 0.5 * flight.odometry_period * rate)
    room = np.floor(np.diff(periods[answered]) + slack) - 1
    room_at_end = np.floor(periods[-1] - periods[answered[-1]] + slack)
    between = np.diff(answered) - 1
    at_end = len(periods) - 1 - answered[-1]
    return int(np.sum(np.clip(room, 0, between)) + min(room_at_end, at_end))


def _saturation(flight: Flight) -> float | None:
    """Return the fraction of commands with a body rate at its bound."""
    if len(flight.commands.w_WB_B) == 0:
        return None
    bound = np.array(flight.mpc.omega_max) - _SATURATION_TOLERANCE
    return float(np.mean(np.any(np.abs(flight.commands.w_WB_B) >= bound, axis=1)))


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _plain(value: Any) -> Any:
    """Return a recorded parameter for JSON, with None for infinite or undefined numbers."""
    if isinstance(value, dict):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return _number(value) if isinstance(value, float) else value

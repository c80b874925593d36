# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Sources of the commands of a flight, distances from its limits, estimates of the controller."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.recordings.evaluation.crash import tilts
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles
from quad_mpc_ros.recordings.flight import Flight

FALLBACKS = [
    source.name.lower() for source in (Source.PLAN, Source.HOVER, Source.IDLE, Source.BLIND)
]
WITHOUT_MPC = (*FALLBACKS, Source.SILENT.name.lower())

_SETTLED_RATIO = 0.5  # of the MPC's ticks; the estimates are read after this share


def commanding(flight: Flight) -> dict[str, Any]:
    """Return the number of ticks of each source, and the first failsafe tick.

    In a flight without commands the last tick counts, which has the reason.
    """
    sources = flight.stats["source"]
    without = np.flatnonzero(np.isin(sources, WITHOUT_MPC))
    if not len(flight.commands.stamp_ns):
        without = np.arange(len(sources))[-1:]
    first = None
    if len(without):
        at = int(without[0])
        first = {
            "time_s": float(flight.tick_time[at]),
            "source": str(sources[at]),
            "reason": str(flight.stats["reason"][at]),
        }
    return {"ticks": dict(Counter(sources.tolist())), "first_without_mpc": first}


def margins(flight: Flight) -> dict[str, Any]:
    """Return the distances of a flight from its limits: times [ms], tilt [rad], the fence [m].

    Tilt and position are from the odometry; None without a limit.
    """
    flying = flight.stats["source"] == Source.MPC.name.lower()
    mpc = flight.mpc
    return {
        "lockstep": mpc.lockstep,
        "control_period_ms": 1e3 / mpc.control_rate,
        "odom_period_ms": 1e3 * flight.odometry_period,
        "odom_timeout_ms": 1e3 * mpc.odom_timeout,
        "odom_age_ms": percentiles(flight.stats["odom_age_ms"][flying], 50, 99),
        "reference_age_ms": percentiles(flight.stats["reference_age_ms"][flying], 50, 99),
        "tilt_max_rad": float(tilts(flight.q_WB_xyzw).max()),
        "tilt_limit_rad": mpc.limits.tilt_max or None,
        "fence_margin_m": _fence_margin(flight),
    }


def estimated(flight: Flight) -> dict[str, Any]:
    """Return the estimates of the flying MPC, with their names in ``mpc/stats``.

    An estimate has the median of the later half of the MPC's ticks, their middle 90 % range, and
    the configured value. Empty without estimator, or without recorded statistics.
    """
    flying = np.flatnonzero(flight.stats["source"] == Source.MPC.name.lower())
    settled = flying[int(_SETTLED_RATIO * len(flying)) :]
    estimates = flight.mpc.on_manifold and flight.mpc.estimate_disturbance
    found = {}
    for name, configured in _configured(flight.mpc).items() if estimates and len(settled) else ():
        spread = percentiles(flight.stats[name][settled], 5, 50, 95)
        low, value, high = (spread[each] for each in ("p5", "p50", "p95"))
        found[name] = {"value": value, "low": low, "high": high, "given": configured}
    return found


def _configured(mpc: MpcConfig) -> dict[str, float]:
    """Return the configured values of the estimates, by names in ``mpc/stats``."""
    roll, pitch, yaw = per_axis(mpc.rate_time_constant)
    return {
        "thrust_scale": 1.0,
        "rate_time_constant_ms": 5e2 * (roll + pitch),
        "yaw_time_constant_ms": 1e3 * yaw,
        "thrust_time_constant_ms": 1e3 * mpc.thrust_time_constant,
        "drag": float(np.mean(per_axis(mpc.drag))),
        "disturbance_x": 0.0,
        "disturbance_y": 0.0,
        "disturbance_z": 0.0,
    }


def _fence_margin(flight: Flight) -> float | None:
    """Return the smallest distance to a wall of the fence [m], negative outside."""
    if not flight.mpc.fence.has_walls:
        return None
    low, high = flight.mpc.fence.walls
    to_walls: Array = np.minimum(flight.p_WB - low, high - flight.p_WB)
    return float(to_walls.min())

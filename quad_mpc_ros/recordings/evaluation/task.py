# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Uncompleted tasks of a flight, and limits that its reference exceeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from quad_mpc_ros.recordings.evaluation.waypoints import waypoints
from quad_mpc_ros.recordings.flight import Flight

_REACHED_DISTANCE = 0.25  # m from a waypoint or goal
_MIN_HOLD_TIME = 2.0  # s: a position that the reference holds so long can be reached
_AXES = ("roll", "pitch", "yaw")


def task_figures(flight: Flight, race: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the ``missed`` tasks and the excesses ``beyond_limits`` as sentences.

    Gates of a course must be passed and its end reached (``race`` has the result); waypoints and
    goals, positions that the reference holds, must be reached before the reference leaves.
    """
    missed = [*_missed_gates(race["gates"] or [], race["lap_time_s"]), *_missed_waypoints(flight)]
    return {"missed": missed, "beyond_limits": list(_beyond_limits(flight))}


def _missed_gates(gates: Sequence[Mapping[str, Any]], lap_time: float | None) -> Iterator[str]:
    missed = [gate["gate"] for gate in gates if not gate["passed"]]
    if missed:
        passed = len(gates) - len(missed)
        yield f"Passed {passed} of {len(gates)} gates, the first missed is gate {missed[0]}."
    elif gates and lap_time is None:
        yield f"Passed all {len(gates)} gates, but did not reach the end of the course."


def _missed_waypoints(flight: Flight) -> Iterator[str]:
    for waypoint in waypoints(flight):
        if not (waypoint.complete or waypoint.duration >= _MIN_HOLD_TIME):
            continue
        error = float(np.linalg.norm(waypoint.p_WB - flight.p_WB[waypoint.last]))
        if not error <= _REACHED_DISTANCE:
            x, y, z = waypoint.p_WB
            why = _avoidance(flight, waypoint.last)
            yield f"Missed the waypoint ({x:.2f}, {y:.2f}, {z:.2f}) m by {error:.2f} m{why}."


def _avoidance(flight: Flight, odometry: int) -> str:
    """Return why obstacle avoidance had left the reference, else an empty string."""
    ticks = flight.stats["stamp_ns"] <= flight.stamp_ns[odometry]
    if not ticks.any():
        return ""
    last = int(np.flatnonzero(ticks)[-1])
    if flight.stats["avoidance"][last] not in ("around", "stopped"):
        return ""
    return f": {flight.stats['avoidance_reason'][last]}"


def _beyond_limits(flight: Flight) -> Iterator[str]:
    """Yield each limit of the MPC that the reference exceeds, at its worst."""
    reference, mpc = flight.reference, flight.mpc
    if reference is None:
        return
    for axis, rates, bound in zip(_AXES, reference.w_WB_B.T, mpc.omega_max, strict=True):
        worst = int(np.argmax(np.abs(rates)))
        if abs(rates[worst]) > bound:
            yield (
                f"The reference needs a {axis} rate of {abs(rates[worst]):.3g} rad/s at "
                f"{flight.time[worst]:.2f} s, mpc.omega_max is {bound:.3g} rad/s."
            )
    for name, worst, exceeds in (
        ("throttle_max", int(np.argmax(reference.throttle)), np.greater_equal),
        ("throttle_min", int(np.argmin(reference.throttle)), np.less_equal),
    ):
        bound = getattr(mpc, name)
        if exceeds(reference.throttle[worst], bound):  # the throttle is one within 0 to 1
            yield (
                f"The reference needs a throttle beyond mpc.{name}, {bound:.2f}, at "
                f"{flight.time[worst]:.2f} s."
            )

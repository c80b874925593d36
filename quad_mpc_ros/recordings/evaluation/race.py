"""How a flight passed the gates of the course that it was told."""

from __future__ import annotations

from typing import Any

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.gate_passages import passages
from quad_mpc_ros.references.gates import Course, read_course

VEHICLE_RADIUS = 0.2
"""Of a ball that holds a vehicle, rotors and all, by default [m]."""


def flown_course(flight: Flight) -> Course | None:
    """Return the course in the recorded parameters; None without one that can be read."""
    gates = recorded_parameters(flight.parameters, ReferenceConfig).get("gates")
    if not gates:
        return None
    try:
        return read_course(str(gates))
    except UserError:  # a file that is on another machine
        return None


def race_figures(flight: Flight) -> dict[str, Any]:
    """Return ``gates``, each passage with its time, and ``lap_time_s``; None without a course."""
    course = flown_course(flight)
    if course is None:
        return {"gates": None, "lap_time_s": None}
    recorded = recorded_parameters(flight.parameters, ReferenceConfig)
    radius = float(recorded.get("radius", VEHICLE_RADIUS))
    lap = passages(course, seconds=flight.time, p_WB=flight.p_WB, radius=radius)
    return {
        "gates": [
            {
                "gate": number,
                "time_s": passage.time,
                "miss_m": passage.miss,
                "passed": passage.passed,
                "clipped": passage.clipped,
            }
            for number, passage in zip(course.numbers, lap.passages, strict=True)
        ],
        "lap_time_s": lap.time,
    }

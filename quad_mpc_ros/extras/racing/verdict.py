# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gate passages of a flight."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.racing.gate_passages import Lap, MovedGates, passages
from quad_mpc_ros.extras.racing.gates import read_course
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.course import Course

VEHICLE_RADIUS = 0.2
"""Default radius of a vehicle's bounding sphere [m]."""


def flown_course(flight: Flight) -> Course | None:
    """Return the course in the recorded parameters; None without a readable course."""
    gates = recorded_parameters(flight.parameters, ReferenceConfig).get("gates")
    if not gates:
        return None
    try:
        return read_course(str(gates))
    except UserError:  # a file on another computer
        return None


def race_figures(flight: Flight) -> dict[str, Any]:
    """Return ``gates``, each passage with its time, and ``lap_time_s``; None without a course.

    Moved gates are evaluated at their last published pose before the passage.
    """
    course = flown_course(flight)
    if course is None:
        return {"gates": None, "lap_time_s": None}
    lap = _lap(course, flight, _moved(course, flight) if flight.gates else None)
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


def drawn_course(flight: Flight) -> Course | None:
    """Return the course with the gate of each passage at its last published pose.

    A missed gate has its last published pose of the flight.
    """
    course = flown_course(flight)
    if course is None or not flight.gates:
        return course
    moved = _moved(course, flight)
    gates = []
    for number, passage in enumerate(_lap(course, flight, moved).passages):
        step = -1
        if passage.passed and passage.time is not None:
            step = int(np.searchsorted(flight.time, passage.time, side="right")) - 1
        gates.append(moved.courses[moved.held[step]].gates[number])
    return dataclasses.replace(course, gates=tuple(gates))


def _lap(course: Course, flight: Flight, moved: MovedGates | None) -> Lap:
    recorded = recorded_parameters(flight.parameters, ReferenceConfig)
    radius = float(recorded.get("radius", VEHICLE_RADIUS))
    return passages(course, seconds=flight.time, p_WB=flight.p_WB, radius=radius, moved=moved)


def _moved(course: Course, flight: Flight) -> MovedGates:
    """Return the course as published in flight, without messages that the controller rejects."""
    courses, since_ns = [course], [np.iinfo(np.int64).min]
    for poses in flight.gates:
        with contextlib.suppress(UserError):
            courses.append(course.moved(poses.p_WG, poses.q_WG_xyzw))
            since_ns.append(poses.publish_time_ns)
    held = np.searchsorted(since_ns, flight.publish_time_ns, side="right") - 1
    return MovedGates(courses=courses, held=held)

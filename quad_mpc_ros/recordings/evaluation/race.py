# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The gate passages of a flight, evaluated by the optional racing package."""

from __future__ import annotations

from typing import Any

from quad_mpc_ros.configuration import optional_part
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.course import Course


def race_figures(flight: Flight) -> dict[str, Any]:
    """Return ``gates``, each passage with its time, and ``lap_time_s``; None without a course.

    A moved gate is evaluated at its reported pose at the time of the passage. Raises
    :class:`UserError` for a flight with a course if racing is not installed.
    """
    figures: dict[str, Any] | None = _racing("race_figures", flight)
    return figures or {"gates": None, "lap_time_s": None}


def drawn_course(flight: Flight) -> Course | None:
    """Return the course with each gate at its reported pose at the time of its passage.

    A gate that was not passed has its last reported pose. None without a course; raises like
    :func:`race_figures`.
    """
    course: Course | None = _racing("drawn_course", flight)
    return course


def _racing(part: str, flight: Flight) -> Any:
    """Return what a part of racing finds in a flight; None without a course."""
    if not recorded_parameters(flight.parameters, ReferenceConfig).get("gates"):
        return None
    return optional_part(part, needed_by=f"{ReferenceConfig.owner}.gates")(flight)

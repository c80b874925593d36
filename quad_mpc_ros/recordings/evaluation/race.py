"""The gate passages of a flight, evaluated by the optional racing package."""

from __future__ import annotations

from typing import Any

from quad_mpc_ros.configuration import optional_part
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.course import Course

_GATES_PARAMETER = f"{ReferenceConfig.owner}.gates"


def race_figures(flight: Flight) -> dict[str, Any]:
    """Return ``gates``, each passage with its time, and ``lap_time_s``; None without a course.

    A moved gate is evaluated at its reported pose at the time of the passage. Raises
    :class:`UserError` for a flight with a course if racing is not installed.
    """
    if not _has_course(flight):
        return {"gates": None, "lap_time_s": None}
    figures: dict[str, Any] = optional_part("race_figures", needed_by=_GATES_PARAMETER)(flight)
    return figures


def drawn_course(flight: Flight) -> Course | None:
    """Return the course with each gate at its reported pose at the time of its passage.

    A gate that was not passed has its last reported pose. None without a course; raises like
    :func:`race_figures`.
    """
    if not _has_course(flight):
        return None
    course: Course | None = optional_part("drawn_course", needed_by=_GATES_PARAMETER)(flight)
    return course


def _has_course(flight: Flight) -> bool:
    return bool(recorded_parameters(flight.parameters, ReferenceConfig).get("gates"))

"""The reference ``gates`` as parameters; the path through a course is made by optional racing."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration import optional_part, parameter
from quad_mpc_ros.references.motion_table import PlannedMotion
from quad_mpc_ros.references.path import Path
from quad_mpc_ros.references.point_table import TableParameters


@dataclass(frozen=True, kw_only=True)
class GateParameters(TableParameters):
    """Which course is flown, and judged."""

    gates: str = parameter(
        "",
        doc="gates: the file of the course, or its text in braces. With another trajectory it is "
        "only drawn, and judged how the flight passes it.",
    )


def gates_path(config: GateParameters) -> Path | PlannedMotion:
    """Return the plan that ``file`` names, or the smooth path through the gates.

    Raises :class:`UserError` for a course that cannot be flown, a plan that does not pass it, and
    where racing is not installed.
    """
    make = optional_part("gates_path", needed_by=f"{config.owner}.trajectory")
    path: Path | PlannedMotion = make(config)
    return path

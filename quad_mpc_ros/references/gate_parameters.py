"""The parameters of the reference ``gates``; the optional racing package computes the path."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration import optional_part, parameter
from quad_mpc_ros.references.motion_table import PlannedMotion
from quad_mpc_ros.references.path import Path
from quad_mpc_ros.references.point_table import TableParameters


@dataclass(frozen=True, kw_only=True)
class GateParameters(TableParameters):
    """Parameters of a course of gates."""

    gates: str = parameter(
        "",
        doc="gates: file of the gates, or the content of the file in braces. With another "
        "trajectory the gates are only drawn, and their passages evaluated.",
    )


def gates_path(config: GateParameters) -> Path | PlannedMotion:
    """Return the plan that ``file`` names, or the smooth path through the gates.

    Raises :class:`UserError` for an infeasible course, a plan that does not pass the course, and
    if racing is not installed.
    """
    make = optional_part("gates_path", needed_by=f"{config.owner}.trajectory")
    path: Path | PlannedMotion = make(config)
    return path

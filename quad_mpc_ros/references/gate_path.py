"""The reference ``gates``: a plan through a course, or without one a smooth path through it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, UserError, parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.gate_passages import passages
from quad_mpc_ros.references.gates import Course, read_course
from quad_mpc_ros.references.minimum_snap import minimum_snap_path
from quad_mpc_ros.references.motion_table import PlannedMotion
from quad_mpc_ros.references.path import Path, SplinePath
from quad_mpc_ros.references.point_table import TableParameters, csv_path

_SAMPLED = 0.005  # s
_AHEAD = 1.0  # m in front of a gate and behind it, where the path is told to go straight through
_SHORTEST = 0.05  # m, between two points


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

    Raises :class:`UserError` for a course that cannot be flown and a plan that does not pass it.
    """
    course = configured_course(config)
    if course is None:
        raise ConfigurationError(
            f"{config.owner}.gates", config.gates, "the file of a course of gates to fly"
        )
    if config.file:
        return _planned(config, course)
    return smooth_path(
        course, max_speed=config.max_speed, max_acceleration=config.max_acceleration
    )


def configured_course(config: GateParameters) -> Course | None:
    """Return the configured course, None for none; raises :class:`UserError`."""
    return read_course(config.gates) if config.gates else None


def smooth_path(course: Course, *, max_speed: float, max_acceleration: float) -> SplinePath:
    """Return a path of minimum snap through the middle of every gate, from rest to rest.

    Where it would pass a gate against its direction, it is led straight through from in front of
    the gate to behind it. Raises :class:`UserError` where that does not help, either.
    """
    straight = [False] * len(course.gates)
    while True:
        path = minimum_snap_path(
            _points(course, straight), max_speed=max_speed, max_acceleration=max_acceleration
        )
        seconds = np.linspace(0.0, path.duration, 2 + round(path.duration / _SAMPLED))
        lap = passages(course, seconds=seconds, p_WB=path.at(seconds).p_WB)
        missed = [i for i, passage in enumerate(lap.passages) if not passage.passed]
        if not missed:
            return path
        if all(straight[i] or course.gates[i].R_WG is None for i in missed):
            raise UserError(
                f"{course.source}: gates[{course.numbers[missed[0]]}]: no smooth path passes it "
                "in its direction; turn it, or plan the course: quad_mpc plan"
            )
        for i in missed:
            straight[i] = True


def _points(course: Course, straight: list[bool]) -> Array:
    points = [course.start]
    for gate, through in zip(course.gates, straight, strict=True):
        if not through or gate.R_WG is None:
            points.append(gate.p_WG)
            continue
        way = gate.R_WG[:, 0]
        if gate.both_ways and float(way @ (gate.p_WG - points[-1])) < 0.0:
            way = -way
        points += [gate.p_WG - _AHEAD * way, gate.p_WG, gate.p_WG + _AHEAD * way]
    if course.end is not None:
        points.append(course.end.p_WB)
    kept = [points[0]]
    kept += [b for a, b in itertools.pairwise(points) if _apart(a, b)]
    return np.array(kept)


def _apart(one: Array, other: Array) -> bool:
    return bool(np.linalg.norm(other - one) > _SHORTEST)


def _planned(config: GateParameters, course: Course) -> Path | PlannedMotion:
    """Return the plan of the configured file, which must pass the course."""
    plan = csv_path(config)
    duration = 1e-9 * plan.period_ns if isinstance(plan, PlannedMotion) else plan.duration
    seconds = np.linspace(0.0, duration, 2 + round(duration / _SAMPLED))
    if isinstance(plan, PlannedMotion):
        p_WB = plan.at(np.round(1e9 * seconds).astype(np.int64).tolist()).p_WB
    else:
        p_WB = plan.at(seconds).p_WB
    lap = passages(course, seconds=seconds, p_WB=p_WB)
    for number, passage in zip(course.numbers, lap.passages, strict=True):
        if not passage.passed:
            raise ConfigurationError(
                f"{config.owner}.file",
                config.file,
                f"a plan through {course.source}: it does not pass gates[{number}]; plan it anew",
            )
    return plan

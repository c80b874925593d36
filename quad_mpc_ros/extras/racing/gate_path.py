# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference ``gates``: a plan through a course, or a smooth path."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.racing.gate_passages import Lap, passages
from quad_mpc_ros.extras.racing.gates import read_course
from quad_mpc_ros.references.course import Course
from quad_mpc_ros.references.minimum_snap import minimum_snap_path
from quad_mpc_ros.references.motion_table import PlannedMotion
from quad_mpc_ros.references.path import Path, SplinePath
from quad_mpc_ros.references.point_table import GateParameters, csv_path

_SAMPLE_PERIOD = 0.005  # s
_LEAD_IN = 1.0  # m, straight part of the path before and behind a gate
_MIN_SPACING = 0.05  # m, between two points
_MIN_HEIGHT, _HEIGHT_RATIO = 0.3, 0.5  # m: lowest height of a path, unless gates are lower
_MAX_INTERMEDIATE_POINTS = 3  # points on the line between two gates


def gates_path(config: GateParameters) -> Path | PlannedMotion:
    """Return the plan in ``file``, or the smooth path through the gates.

    Raises :class:`UserError` for an invalid course, or a plan that does not pass the course.
    """
    course = configured_course(config)
    if course is None:
        raise ConfigurationError(f"{config.owner}.gates", config.gates, "a gate file")
    if config.file:
        plan = csv_path(dataclasses.replace(config, origin=(0.0, 0.0)))  # in the course's frame
        _check_passes(plan, course, config)
        return plan
    return smooth_path(
        course, max_speed=config.max_speed, max_acceleration=config.max_acceleration
    )


def configured_course(config: GateParameters) -> Course | None:
    """Return the configured course, or None. Raises :class:`UserError`."""
    return read_course(config.gates) if config.gates else None


def smooth_path(course: Course, *, max_speed: float, max_acceleration: float) -> SplinePath:
    """Return a minimum-snap path through the centres of all gates, from rest to rest.

    A gate that would be passed in the wrong direction gets waypoints before and behind it. A leg
    that is too low gets waypoints on the line between its gates. Raises :class:`UserError` if the
    path still misses a gate.
    """
    waypoints = _Waypoints(course)
    while True:
        path = minimum_snap_path(
            waypoints.points(), max_speed=max_speed, max_acceleration=max_acceleration
        )
        seconds = np.linspace(0.0, path.duration, 2 + round(path.duration / _SAMPLE_PERIOD))
        p_WB = path.at(seconds).p_WB
        lap = passages(course, seconds=seconds, p_WB=p_WB)
        if not waypoints.improve(lap, seconds=seconds, height=p_WB[:, 2]):
            break
    for number, passage in zip(course.numbers, lap.passages, strict=True):
        if not passage.passed:
            raise UserError(
                f"{course.source}: gates[{number}]: no smooth path passes this gate in its "
                "direction; turn the gate, or plan the race: quad_mpc plan"
            )
    return path


class _Waypoints:
    """The waypoints of a smooth path through a course, with more waypoints as needed."""

    def __init__(self, course: Course) -> None:
        self._course = course
        self._straight = [False] * len(course.gates)
        self._between = [0] * (len(course.places()) - 1)
        self._lowest = min(_MIN_HEIGHT, *(_HEIGHT_RATIO * place[2] for place in course.places()))

    def improve(self, lap: Lap, *, seconds: Array, height: Array) -> bool:
        """Add waypoints where a path misses a gate or is too low; return whether any was added."""
        before = [*self._straight], [*self._between]
        for i, passage in enumerate(lap.passages):
            if not passage.passed and self._course.gates[i].R_WG is not None:
                self._straight[i] = True
        times = [passage.time for passage in lap.passages]
        ends = [0.0, *(time for time in times if time is not None), float(seconds[-1])]
        if None not in times:
            for leg in range(len(self._between)):
                inside = (seconds >= ends[leg]) & (seconds <= ends[leg + 1])
                if height[inside].min(initial=np.inf) < self._lowest:
                    self._between[leg] = min(2 * self._between[leg] + 1, _MAX_INTERMEDIATE_POINTS)
        return before != (self._straight, self._between)

    def points(self) -> Array:
        """Return the points (n, 3) [m]."""
        places, found = self._course.places(), [self._course.start]
        for leg, (begin, end) in enumerate(itertools.pairwise(places)):
            shares = np.linspace(0.0, 1.0, self._between[leg] + 2)[1:-1]
            found += [begin + share * (end - begin) for share in shares]
            found += self._through(leg, begin) if leg < len(self._course.gates) else [end]
        kept = [found[0]]
        kept += [b for a, b in itertools.pairwise(found) if _apart(a, b)]
        return np.array(kept)

    def _through(self, number: int, begin: Array) -> list[Array]:
        gate = self._course.gates[number]
        if gate.R_WG is None or not self._straight[number]:
            return [gate.p_WG]
        normal = gate.R_WG[:, 0]
        if gate.both_ways and float(normal @ (gate.p_WG - begin)) < 0.0:
            normal = -normal
        return [gate.p_WG - _LEAD_IN * normal, gate.p_WG, gate.p_WG + _LEAD_IN * normal]


def _apart(one: Array, other: Array) -> bool:
    return bool(np.linalg.norm(other - one) > _MIN_SPACING)


def _check_passes(plan: Path | PlannedMotion, course: Course, config: GateParameters) -> None:
    """Reject the plan in the configured file unless it passes the course."""
    duration = 1e-9 * plan.period_ns if isinstance(plan, PlannedMotion) else plan.duration
    seconds = np.linspace(0.0, duration, 2 + round(duration / _SAMPLE_PERIOD))
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
                f"a plan through {course.source}; it misses gates[{number}]: plan again",
            )

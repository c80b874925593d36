# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Course files, and checks of a course.

A course is YAML, in the world (ENU, m, rad)::

    start: [-5.0, 4.5, 1.2]                  # or {position: [x, y, z], yaw: heading of the nose}
    end: [4.75, -0.9, 1.2]                   # or {position: …, tolerance: 0.3, at_rest: false}
    laps: 1                                  # how often the gates are passed in their order
    order: [1, 2, 3, 1]                      # of the gates by number, from 1; else all of them
    gates:
      - {position: [-1.1, -1.6, 3.6], tolerance: 0.3}
      - {position: [9.2, 6.6, 1.0], yaw: -0.35, width: 2.4, height: 2.4, direction: both}
      - {position: [9.2, -4.0, 1.2], quaternion: [x, y, z, w], tolerance: 1.0}

``yaw`` is the heading of the passage. A ``quaternion`` rotates the gate's axes to the world: x
through the gate, y across, z up. With yaw or quaternion a gate is a planar opening: a rectangle,
or with ``tolerance`` a circle. Without orientation it is a ball that the vehicle's centre must
touch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError, files, ros_yaml
from quad_mpc_ros.configuration.errors import text_of
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.extras.yaml_entries import Entry
from quad_mpc_ros.references.course import OFF_UNIT, Course, Finish, Gate

_MIN_GATES, _MAX_GATES = 2, 100  # passages of gates
_MAX_OPENING = 100.0  # m, of an opening
_END_TOLERANCE = 0.3  # m
_SAME_PLACE = 1e-3  # m
_MAX_REVERSED_COSINE = 0.2  # cosine: more than 100 degrees from the legs before and after the gate
_COURSE_KEYS = ("start", "end", "laps", "order", "gates")
_TOGT_KEYS = {"initState", "endState", "orders"}
_GATE_KEYS = ("position", "yaw", "quaternion", "width", "height", "tolerance", "direction")
_DIRECTIONS = ("forward", "both")


def read_course(given: str | Path) -> Course:
    """Return the course in a file, a shipped course by name, or a course as text in braces.

    Raises :class:`UserError` for an unreadable file or an invalid course, with file, entry, given
    and expected value.
    """
    content, source = _content(str(given))
    return course_from(content, source=source)


def course_text(given: str | Path) -> str:
    """Return a course as one line of text, for a parameter. Raises like :func:`read_course`."""
    content, source = _content(str(given))
    course_from(content, source=source)
    text = ros_yaml.written(dict(content), default_flow_style=True, width=math.inf)
    return text.strip()


def _content(given: str) -> tuple[Mapping[Any, Any], str]:
    """Return the content of a file, and its name in errors."""
    source = "gates"
    if given.lstrip().startswith("{"):
        content = ros_yaml.read_text(given, source)
    else:
        source = given
        path = files.expanded(given)
        shipped = files.shipped("gates")
        if given in shipped and not files.is_file(path):
            path = shipped[given]
        try:
            content = ros_yaml.read_file(path)
        except UserError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                raise UserError(f"{error} (shipped: {', '.join(shipped)})") from error
            raise
    if not isinstance(content, Mapping):
        raise UserError(f"{source}: given {text_of(content)}, expected start, end and gates")
    if _TOGT_KEYS & content.keys():
        raise UserError(
            f"{source}: this is a track of TOGT-Planner ({', '.join(sorted(_TOGT_KEYS))}), "
            "expected start, end and gates; write it as docs/howto/racing.md describes"
        )
    return content, source


def course_from(content: Mapping[Any, Any], *, source: str = "gates") -> Course:
    """Return the course in a file's content; ``source`` is the prefix of errors."""
    entry = Entry(content, source=source)
    entry.check_keys(_COURSE_KEYS)
    gates = [_gate(each) for each in entry.get("gates").items("a list of gates")]
    count = len(gates)
    laps = entry.get("laps", 1).whole(least=1, most=_MAX_GATES)
    order = entry.get("order", list(range(1, count + 1)))
    places = order.items(f"numbers of gates from 1 to {count}")
    numbers = [each.whole(least=1, most=count) for each in places] * laps
    if not _MIN_GATES <= len(numbers) <= _MAX_GATES:
        raise Entry(len(numbers), source=source, name="gates").error(
            f"{_MIN_GATES} to {_MAX_GATES} passages of gates in all laps"
        )
    start, start_yaw = _start(entry.get("start"))
    course = Course(
        source=source,
        start=start,
        start_yaw=start_yaw,
        gates=tuple(gates[number - 1] for number in numbers),
        numbers=tuple(numbers),
        end=_end(entry.get("end")) if content.get("end") is not None else None,
    )
    _check_headings(course)
    return course


def _place(entry: Entry) -> Array:
    """Return a position (3,) [m], which must not be below the ground."""
    found = entry.vector()
    if found[2] < 0.0:
        raise entry.error("a position above the ground, z >= 0")
    return found


def _start(entry: Entry) -> tuple[Array, float]:
    if isinstance(entry.value, Mapping):
        entry.check_keys(("position", "yaw"))
        return _place(entry.get("position")), entry.get("yaw", 0.0).number()
    if entry.value is None:
        raise entry.error("[x, y, z], where the vehicle starts at rest")
    return _place(entry), 0.0


def _end(entry: Entry) -> Finish:
    if not isinstance(entry.value, Mapping):
        return Finish(p_WB=_place(entry), tolerance=_END_TOLERANCE, at_rest=True)
    entry.check_keys(("position", "tolerance", "at_rest"))
    at_rest = entry.value.get("at_rest", True)
    if not isinstance(at_rest, bool):
        raise entry.error("true, or false for an end passed in flight", key="at_rest")
    tolerance = entry.get("tolerance", _END_TOLERANCE).number(above=0.0, most=_MAX_OPENING)
    return Finish(p_WB=_place(entry.get("position")), tolerance=tolerance, at_rest=at_rest)


def _gate(entry: Entry) -> Gate:
    entry.check_keys(_GATE_KEYS)
    given, R_WG = entry.value, _axes(entry)
    is_round = "tolerance" in given
    if is_round == ("width" in given or "height" in given):
        raise entry.error("either width and height, or tolerance")
    if not is_round and R_WG is None:
        raise entry.error("yaw or quaternion with width and height")
    names = ("tolerance", "tolerance") if is_round else ("width", "height")
    sizes = [entry.get(name).number(above=0.0, most=_MAX_OPENING) for name in names]
    direction = given.get("direction", "both" if R_WG is None else "forward")
    if direction not in _DIRECTIONS or (R_WG is None and direction == "forward"):
        expected = " or ".join(_DIRECTIONS) + "; forward needs yaw or quaternion"
        raise entry.error(expected, key="direction")
    place = entry.get("position").vector()
    if place[2] <= 0.0:
        raise entry.error("a centre above the ground, z > 0", key="position")
    share = 1.0 if is_round else 0.5
    return Gate(
        p_WG=place,
        R_WG=R_WG,
        half_width=share * sizes[0],
        half_height=share * sizes[1],
        is_round=is_round,
        both_ways=direction == "both",
    )


def _axes(entry: Entry) -> Array | None:
    if "yaw" in entry.value and "quaternion" in entry.value:
        raise entry.error("yaw or quaternion, not both")
    if "yaw" in entry.value:
        return so3.exp(np.array([0.0, 0.0, entry.get("yaw").number()]))
    if "quaternion" in entry.value:
        q_xyzw = entry.get("quaternion").vector(size=4)
        length = float(np.linalg.norm(q_xyzw))
        if abs(length - 1.0) > OFF_UNIT:
            raise entry.error("x, y, z, w of length 1", key="quaternion")
        return so3.rotation_from_quaternion_xyzw(q_xyzw / length)
    return None


def _check_headings(course: Course) -> None:
    """Reject successive gates at one position, and gates with a reversed heading."""
    places = course.places()
    names = ["start", *(f"gates[{number}]" for number in course.numbers), "end"]
    for i, step in enumerate(np.diff(places, axis=0)):
        if np.linalg.norm(step) < _SAME_PLACE:
            place = Entry(places[i + 1].tolist(), source=course.source, name=names[i + 1])
            raise place.error(f"a position that differs from {names[i]}")
    steps = np.diff(places, axis=0)
    for i, gate in enumerate(course.gates):
        if gate.R_WG is None or gate.both_ways:
            continue
        ways = (steps[i : i + 2] / np.linalg.norm(steps[i : i + 2], axis=1)[:, None]) @ gate.R_WG
        if (ways[:, 0] < -_MAX_REVERSED_COSINE).all():
            after = f" and on to {names[i + 2]}" if len(ways) > 1 else ""
            heading = math.atan2(gate.R_WG[1, 0], gate.R_WG[0, 0])
            given = f"the heading {heading:.3g} rad"
            raise Entry(given, source=course.source, name=names[i + 1]).error(
                f"a direction along the path from {names[i]}{after}: the gate faces backwards; "
                "add or subtract pi, or set direction: both"
            )

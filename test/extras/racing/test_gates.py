# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Courses of gates: what is read, what is refused, and what lies in an opening."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.files import shipped
from quad_mpc_ros.extras.racing.gates import course_from, course_text, read_course

COURSE: dict[str, Any] = {
    "start": [0.0, 0.0, 1.0],
    "end": [20.0, 0.0, 1.0],
    "gates": [
        {"position": [5.0, 0.0, 1.5], "yaw": 0.0, "width": 2.0, "height": 1.0},
        {"position": [10.0, 3.0, 2.0], "tolerance": 0.5},
        {"position": [15.0, 0.0, 1.5], "quaternion": [0.0, 0.0, 0.0, 1.0], "tolerance": 0.8},
    ],
}


def changed(**changes: Any) -> dict[str, Any]:
    """Return the course with other values, by keys like ``gates__0__yaw``; None leaves one out."""
    made = copy.deepcopy(COURSE)
    for name, value in changes.items():
        *way, last = (int(each) if each.isdigit() else each for each in name.split("__"))
        place: Any = made
        for step in way:
            place = place[step]
        if value is None:
            del place[last]
        else:
            place[last] = value
    return made


def test_reads_openings_balls_and_laps() -> None:
    course = course_from(changed(laps=2, order=[1, 2]))
    assert course.numbers == (1, 2, 1, 2)
    first, ball = course.gates[:2]
    assert first.R_WG is not None and ball.R_WG is None
    assert_allclose(first.R_WG, np.eye(3), atol=1e-15)
    assert (first.half_width, first.half_height) == (1.0, 0.5)
    assert ball.half_width == 0.5 and ball.both_ways
    assert course.end is not None and course.end.at_rest
    assert_allclose(course.places()[[0, -1]], [COURSE["start"], COURSE["end"]])


def test_heading_and_quaternion_agree() -> None:
    turn = [0.0, 0.0, math.sin(0.35), math.cos(0.35)]
    by_yaw = course_from(changed(gates__0__yaw=0.7)).gates[0]
    by_quaternion = course_from(changed(gates__0__yaw=None, gates__0__quaternion=turn)).gates[0]
    assert by_yaw.R_WG is not None and by_quaternion.R_WG is not None
    assert_allclose(by_yaw.R_WG, by_quaternion.R_WG, atol=1e-12)
    assert_allclose(by_yaw.R_WG[:, 0], [math.cos(0.7), math.sin(0.7), 0.0])  # the way through


def test_edge_distance_is_the_distance_to_the_opening() -> None:
    course = course_from(COURSE)
    offsets = np.array([[0, 0, 0], [0, 0.9, 0], [0, 1.3, 0], [0, 1.3, 0.9]], dtype=np.float64)
    assert_allclose(course.gates[0].room(offsets), [0.5, 0.1, -0.3, -0.5])
    assert_allclose(course.gates[1].room(offsets[:2]), [0.5, -0.4])
    assert_allclose(course.gates[2].room(offsets[:2]), [0.8, -0.1])


def test_corners_lie_on_the_edge() -> None:
    for gate in course_from(COURSE).gates:
        offset = gate.corners() - gate.p_WG
        if gate.R_WG is not None:
            offset = offset @ gate.R_WG
        assert_allclose(gate.room(offset), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", sorted(shipped("gates")))
def test_shipped_courses_are_read_by_name_and_from_their_text(name: str) -> None:
    course, again = read_course(name), read_course(course_text(name))
    assert "\n" not in course_text(name)
    assert course.numbers == again.numbers
    assert_allclose(course.places(), again.places())


MANY = [{"position": [float(3 * k), 0.0, 1.0], "tolerance": 0.3} for k in range(1, 201)]
NAN = float("nan")
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "not finite": ({"gates__0__position": [5.0, NAN, 1.5]}, "gates[1].position: given [5.0, nan,"),
    "no size": ({"gates__1__tolerance": None}, "gates[2]: given {'position'"),
    "both sizes": ({"gates__0__tolerance": 0.4}, "expected either width and height, or tolerance"),
    "no heading": ({"gates__0__yaw": None}, "expected yaw or quaternion with width"),
    "both headings": ({"gates__2__yaw": 0.0}, "expected yaw or quaternion, not both"),
    "no rotation": ({"gates__2__quaternion": [0.0, 0.0, 0.0, 0.9]}, "x, y, z, w of length 1"),
    "direction of a ball": ({"gates__1__direction": "forward"}, "forward needs yaw"),
    "unknown key": ({"gates__0__heigth": 1.0}, "gates[1].heigth: unknown (did you mean height?)"),
    "unknown entry": ({"lap": 2}, "lap: unknown (did you mean laps?)"),
    "no start": ({"start": None}, "start: given None, expected [x, y, z]"),
    "one gate": ({"gates": COURSE["gates"][:1]}, "gates: given 1, expected 2 to 100 passages"),
    "200 gates": ({"gates": MANY}, "gates: given 200, expected 2 to 100 passages of gates"),
    "laps": ({"laps": 0}, "laps: given 0, expected a whole number from 1"),
    "order": ({"order": [1, 4]}, "order[2]: given 4, expected a whole number from 1 to 3"),
    "inside the ground": ({"gates__1__position": [10.0, 3.0, -0.2]}, "a centre above the ground"),
    "start in the ground": (
        {"start": [0.0, 0.0, -1.0]},
        "start: given [0.0, 0.0, -1.0], expected",
    ),
    "same place": ({"end": [15.0, 0.0, 1.5]}, "a position that differs from gates[3]"),
    "twice in a row": ({"order": [1, 1, 2]}, "a position that differs from gates[1]"),
    "turned round": ({"gates__0__yaw": math.pi}, "the gate faces backwards; add or subtract pi"),
    "end at speed": ({"end": {"position": [20, 0, 1], "at_rest": 1}}, "end.at_rest: given 1"),
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_rejects_bad_courses_in_one_line(mistake: str) -> None:
    changes, reason = REFUSED[mistake]
    with pytest.raises(UserError) as error:
        course_from(changed(**changes), source="course.yaml")
    assert str(error.value).startswith("course.yaml: ")
    assert reason in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[1, 2]", "given [1, 2], expected start, end and gates"),
        ("gates: [", "not YAML"),
        ("gates: [1]\ngates: [2]", "line 2, column 1: 'gates' is given twice"),
        ("gates: 2026-13-45", "gates: given '2026-13-45', expected a list of gates"),
        ("a = 1", "given 'a = 1', expected start, end and gates"),
        ("initState: {pos: [0, 0, 1]}\norders: [Gate1]", "this is a track of TOGT-Planner"),
        ("gates: &all [1]\nstart: *all", "line 2, column 8: an alias (*name)"),
        (b"\xff\xfe\x00", "not UTF-8 at byte 0"),
    ],
)
def test_rejects_a_file_without_a_course(text: str | bytes, reason: str, tmp_path: Path) -> None:
    file = tmp_path / "course.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(UserError, match=r"course\.yaml") as error:
        read_course(file)
    assert reason in str(error.value)


def test_names_a_missing_file_and_what_is_shipped() -> None:
    with pytest.raises(UserError, match=r"nowhere: cannot be read.*split_s"):
        read_course("nowhere")

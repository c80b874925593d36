# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gates are drawn with their pose at the passage."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from quad_mpc_ros.analysis.figures import space
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.recordings.evaluation.race import drawn_course, race_figures
from quad_mpc_ros.recordings.flight import Flight, GatePoses

COUNT = 400  # odometries of two rounds
WIDTH, HEIGHT, RADIUS = 1.2, 0.6, 0.2
COURSE = {
    "start": [0.0, -2.0, 1.0],
    "laps": 2,
    "gates": [
        {"position": [2.0, 0.0, 1.0], "yaw": math.pi / 2, "width": WIDTH, "height": HEIGHT},
        {"position": [-2.0, 0.0, 1.0], "tolerance": RADIUS},
    ],
}


def gates_at(flight: Flight, at: int, *, x: float, yaw: float, ball: float) -> GatePoses:
    """Return the gate in its plane at ``x``, turned by ``yaw``, and the other one at ``ball``."""
    turned = [0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]
    return GatePoses(
        publish_time_ns=int(flight.publish_time_ns[at]),
        p_WG=np.array([[x, 0.0, 1.0], [ball, 0.0, 1.0]]),
        q_WG_xyzw=np.array([turned, [0.0, 0.0, 0.0, 1.0]]),
    )


@pytest.fixture
def racing(make_flight: Callable[..., Flight]) -> Flight:
    """Return a round at 2 m from the middle and one at 3 m, from the south, against the clock."""
    angle = np.linspace(0.0, 4.0 * np.pi, COUNT) - np.pi / 2
    distance = np.where(np.arange(COUNT) < COUNT // 2, 2.0, 3.0)
    p_WB = np.column_stack((np.cos(angle), np.sin(angle), np.ones(COUNT)))
    p_WB[:, :2] *= distance[:, None]
    parameters = {"reference": {"gates": str(COURSE), "trajectory": "gates"}}
    return make_flight(COUNT, p_WB=p_WB, parameters=parameters)


def opening(x: float, *, yaw: float) -> Array:
    """Return the corners (4, 3) of the opening, by its sides."""
    across = np.array([-math.sin(yaw), math.cos(yaw), 0.0]) * WIDTH / 2
    up = np.array([0.0, 0.0, HEIGHT / 2])
    corners = np.array([across + up, across - up, -across - up, -across + up])
    return np.asarray(np.array([x, 0.0, 1.0]) + corners)


def test_static_gates_are_drawn_once_at_their_configured_pose(racing: Flight) -> None:
    course = drawn_course(racing)
    assert course is not None
    (one, gate), (two, ball) = space.drawn_gates(course)
    assert (one, two) == (1, 2)
    np.testing.assert_allclose(gate.corners()[:4], opening(2.0, yaw=math.pi / 2), atol=1e-12)
    offset = np.linalg.norm(ball.corners() - [-2.0, 0.0, 1.0], axis=1)
    np.testing.assert_allclose(offset, RADIUS)


def test_moved_gates_are_drawn_at_their_pose_of_the_passage(racing: Flight) -> None:
    """The gates of the second lap are further out and turned; later poses are not drawn."""
    flight = dataclasses.replace(
        racing,
        gates=(
            gates_at(racing, COUNT // 2, x=3.0, yaw=math.pi / 2 + 0.3, ball=-3.0),
            gates_at(racing, COUNT - 10, x=7.0, yaw=math.pi / 2, ball=-7.0),
        ),
    )
    assert [gate["passed"] for gate in race_figures(flight)["gates"]] == [True] * 4
    course = drawn_course(flight)
    assert course is not None
    drawn = space.drawn_gates(course)
    assert [number for number, _ in drawn] == [1, 1, 2, 2]
    np.testing.assert_allclose(drawn[0][1].corners()[:4], opening(2.0, yaw=math.pi / 2), atol=1e-9)
    turned = opening(3.0, yaw=math.pi / 2 + 0.3)
    np.testing.assert_allclose(drawn[1][1].corners()[:4], turned, atol=1e-9)
    assert [gate.p_WG[0] for _, gate in drawn[2:]] == [-2.0, -3.0]


def test_draws_a_missed_gate_at_its_last_published_pose(racing: Flight) -> None:
    flight = dataclasses.replace(racing, gates=(gates_at(racing, 0, x=5.0, yaw=0.1, ball=-2.0),))
    course = drawn_course(flight)
    assert course is not None
    assert [gate.p_WG[0] for _, gate in space.drawn_gates(course)] == [5.0, -2.0]

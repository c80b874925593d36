# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Several shapes over time, and the volume of flight."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.simulation.shapes import Box, Cylinder, Scene, Shape, Sphere, Volume

RANDOM = np.random.default_rng(3)


def shapes(count: int = 40) -> list[Shape]:
    made: list[Shape] = []
    for number in range(count):
        place, speed = RANDOM.uniform(-10, 10, 3), RANDOM.normal(size=3) * (number % 3 == 0)
        common = {"p_WO": place, "v_WO_W": speed, "appears_at": 0.5 * (number % 4)}
        kinds = (
            Sphere(radius=0.4, **common),
            Cylinder(radius=0.2, height=3.0, **common),
            Box(size=RANDOM.uniform(0.2, 2.0, 3), **common),
        )
        made.append(kinds[number % len(kinds)])
    return made


def test_clearances_are_the_minimum_over_the_present_shapes() -> None:
    scene = Scene(shapes())
    times, places = np.linspace(0.0, 4.0, 60), RANDOM.uniform(-12, 12, (60, 3))
    expected = [
        min(
            float(shape.after(time).distance(place)[0])
            for shape in scene.shapes
            if shape.appears_at <= time
        )
        for place, time in zip(places[:, None], times.tolist(), strict=True)
    ]
    assert scene.clearances(places, times) == pytest.approx(expected, abs=1e-12)


def test_near_contains_all_shapes_in_reach() -> None:
    scene = Scene(shapes())
    near = scene.near(np.zeros(3), 5.0, 2.0)
    in_reach = [s for s in scene.there(2.0) if s.distance(np.zeros((1, 3)))[0] <= 5.0]
    places = {tuple(shape.p_WO) for shape in near}
    assert {tuple(shape.p_WO) for shape in in_reach} <= places


def test_static_shapes_exist_from_the_start_and_do_not_move() -> None:
    scene = Scene(shapes())
    assert all(not s.moves and s.appears_at == 0.0 for s in scene.static.shapes)
    assert scene.changes and not scene.static.changes


def test_a_volume_is_left_through_its_nearest_wall() -> None:
    volume = Volume(minimum=np.zeros(3), maximum=np.array([4.0, 6.0, 3.0]))
    assert volume.distance(np.array([[2.0, 3.0, 1.0], [5.0, 3.0, 1.0]])).tolist() == [1.0, -1.0]

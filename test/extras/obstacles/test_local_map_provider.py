# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""When a local map is made, and by whom."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.obstacles import Standing

from quad_mpc_ros.extras.obstacles.local_map import LocalMap, LocalMapProvider

START = np.zeros(3)
POINTS = np.array([[2.0, 0.0, 0.0], [0.0, 3.0, 0.0]])


def map_at(surroundings: LocalMapProvider, x: float) -> LocalMap:
    return surroundings.at(np.array([x, 0.0, 0.0]), 10**9, radius=6.0, far=1.0)


def test_map_is_valid_until_obstacles_change_or_the_vehicle_moves_a_metre() -> None:
    standing = Standing(POINTS)
    surroundings = LocalMapProvider(standing)
    first = map_at(surroundings, 0.0)
    assert map_at(surroundings, 0.9) is first
    assert map_at(surroundings, 1.1) is not first
    second = map_at(surroundings, 1.1)
    standing.revision += 1
    assert map_at(surroundings, 1.1) is not second


def test_ticks_use_the_previous_map_until_the_new_map_is_built() -> None:
    standing, calls = Standing(POINTS), []
    surroundings = LocalMapProvider(standing)
    surroundings.wake = lambda: calls.append(True)
    first = map_at(surroundings, 0.0)  # there is none of before
    assert calls == []
    surroundings.update_map()
    assert map_at(surroundings, 0.0) is first
    standing.revision += 1
    assert map_at(surroundings, 0.0) is first
    assert calls == [True]
    surroundings.update_map()
    renewed = map_at(surroundings, 0.0)
    assert renewed is not first
    assert renewed.revision == standing.revision
    assert calls == [True]


def test_next_map_is_centred_at_the_last_position() -> None:
    surroundings = LocalMapProvider(Standing(POINTS))
    surroundings.wake = lambda: None
    map_at(surroundings, 0.0)
    map_at(surroundings, 1.5)
    surroundings.update_map()
    assert map_at(surroundings, 1.5).centre == pytest.approx([1.5, 0.0, 0.0])


def test_discards_a_map_of_a_distant_position() -> None:
    surroundings = LocalMapProvider(Standing(POINTS))
    surroundings.wake = lambda: None
    first = map_at(surroundings, 0.0)
    assert map_at(surroundings, 2.5) is not first
    surroundings.forget()
    second = map_at(surroundings, 2.5)
    surroundings.forget()
    assert map_at(surroundings, 2.5) is not second


def test_grid_is_precomputed_only_if_paths_are_searched() -> None:
    standing = Standing(POINTS)
    surroundings = LocalMapProvider(standing)
    surroundings.wake = lambda: None

    def renewed() -> LocalMap:
        standing.revision += 1
        surroundings.update_map()
        return map_at(surroundings, 0.0)

    map_at(surroundings, 0.0)
    assert renewed()._grid is None
    grid = map_at(surroundings, 0.0).grid
    assert grid.distances.min() < 0.2
    assert renewed()._grid is not None  # the one before was searched
    assert renewed()._grid is None


def test_clearance_considers_all_points() -> None:
    rng = np.random.default_rng(0)
    points, places = rng.uniform(-2.0, 2.0, (50, 3)), rng.uniform(-2.0, 2.0, (200, 3))
    here = LocalMap(points, centre=START, radius=4.0, far=1.0, revision=0)
    apart = np.linalg.norm(places[:, None] - here.points, axis=2).min(axis=1)
    assert here.are_clear(places, 0.7).tolist() == (apart >= 0.7).tolist()
    nothing = LocalMap(np.zeros((0, 3)), centre=START, radius=4.0, far=1.0, revision=0)
    assert nothing.are_clear(places, 0.7).all()

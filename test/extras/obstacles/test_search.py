# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The local grid and its search: distances and lengths by brute force."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.sparse import lil_matrix
from scipy.sparse.csgraph import dijkstra

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.obstacles.moving import Movers
from quad_mpc_ros.extras.obstacles.search import (
    Grid,
    SearchBuffers,
    distance_at,
    fill,
    search,
    shortened,
)

NOTHING = Movers.none()
FAR = 0.8


def filled(points: Array, *, half: tuple[float, float] = (3.0, 1.0), cell: float = 0.2) -> Grid:
    grid = Grid.about(np.zeros(3), half=half, cell=cell, far=FAR)
    fill(np.ascontiguousarray(points), grid)
    return grid


def found(grid: Grid, start: Array, goal: Array, **given: Any) -> tuple[Array, bool]:
    """Search in a workspace of which another search has left its traces."""
    others: dict[str, Any] = {"keep": 0.4, "floor": -5.0, "speed": 1.0, "movers": NOTHING}
    workspace = SearchBuffers.of(grid.distances.size)
    search(grid, goal, np.zeros(3), **others, workspace=workspace)
    return search(grid, start, goal, **{**others, **given}, workspace=workspace)


def centres(grid: Grid) -> Array:
    axes = [grid.origin[k] + grid.cell * np.arange(n) for k, n in enumerate(grid.distances.shape)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def wall(*, gap: bool) -> Array:
    """Return points of a wall across x = 1, with a gap far to the left or without."""
    y, z = np.arange(-3.5, 3.6, 0.1), np.arange(-1.5, 1.6, 0.1)
    if gap:
        y = y[(y < 1.0) | (y > 2.6)]
    Y, Z = np.meshgrid(y, z)
    return np.stack([np.ones(Y.size), Y.ravel(), Z.ravel()], axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_cell_distances_are_to_the_nearest_point(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-3.5, 3.5, size=(60, 3))
    grid = filled(points)
    exact = np.linalg.norm(centres(grid)[..., None, :] - points, axis=-1).min(axis=-1)
    np.testing.assert_allclose(grid.distances, np.minimum(exact, FAR), atol=1e-6)
    place = np.array([0.31, -0.47, 0.13])
    around = np.linalg.norm(points - place, axis=1).min()
    assert distance_at(grid, *place) == pytest.approx(min(around, FAR), abs=0.2)


def test_path_through_a_gap_keeps_its_clearance_and_reaches_the_goal() -> None:
    points = wall(gap=True)
    grid, keep = filled(points), 0.4
    start, goal = np.array([-1.0, -1.0, 0.0]), np.array([2.5, -1.0, 0.0])
    way, arrives = found(grid, start, goal)
    assert arrives
    apart = np.linalg.norm(way[:, None] - points, axis=2).min(axis=1)
    assert apart.min() >= keep - 1e-9
    corners = shortened(grid, way, keep, 1.0, Movers.none())
    assert len(corners) < len(way)
    places = np.vstack(
        [a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in pairwise(corners)]
    )
    apart = np.linalg.norm(places[:, None] - points, axis=2).min(axis=1)
    assert apart.min() >= keep - 0.05, "between cells the field is a little off"


def test_path_to_a_blocked_goal_ends_in_front_of_the_wall() -> None:
    points = wall(gap=False)
    goal = np.array([2.5, 0.0, 0.0])
    way, arrives = found(filled(points), np.array([-1.0, 0.0, 0.0]), goal)
    assert not arrives
    assert way[-1, 0] < 0.61
    assert abs(way[-1, 1]) < 0.3, "in front of where it was to go"


def test_path_length_equals_dijkstra() -> None:
    """By SciPy, on the same cells, where nothing is near enough to cost more."""
    points = np.zeros((0, 3))
    grid = filled(points, half=(1.0, 0.4))
    start, goal = np.array([-0.9, -0.9, -0.3]), np.array([0.9, 0.5, 0.3])
    way, arrives = found(grid, start, goal)
    assert arrives
    weighted = np.diff(way, axis=0) * [1.0, 1.0, 1.5]
    length = np.linalg.norm(weighted, axis=1).sum()
    shape, cells = grid.distances.shape, np.argwhere(grid.distances > 0)
    graph = lil_matrix((len(cells), len(cells)))
    for number, cell in enumerate(cells):
        near = np.abs(cells - cell).max(axis=1) == 1
        for other in np.flatnonzero(near):
            step = (cells[other] - cell) * grid.cell * [1.0, 1.0, 1.5]
            graph[number, other] = np.linalg.norm(step)
    first, last = (
        np.ravel_multi_index(tuple(np.rint((p - grid.origin) / grid.cell).astype(int)), shape)
        for p in (start, goal)
    )
    assert length == pytest.approx(dijkstra(graph.tocsr(), indices=first)[last])


def test_path_from_a_too_close_start_first_leads_away() -> None:
    points = np.array([[0.0, 0.1, z] for z in np.arange(-1.0, 1.0, 0.1)])
    way, arrives = found(filled(points), np.zeros(3), np.array([0.0, 2.0, 0.0]), keep=0.5)
    assert arrives
    apart = np.linalg.norm(way[:, None, :2] - points[:, :2], axis=2).min(axis=1)
    late = apart[np.argmax(apart >= 0.5) :]
    assert late.min() >= 0.5 - 1e-9, "once away it stays away"


def test_path_stays_above_the_floor() -> None:
    y, z = np.arange(-3.5, 3.6, 0.1), np.arange(-0.3, 1.6, 0.1)
    Y, Z = np.meshgrid(y, z)
    points = np.stack([np.ones(Y.size), Y.ravel(), Z.ravel()], axis=1)
    start, goal = np.array([-1.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.0])
    way, arrives = found(filled(points), start, goal, keep=0.3)
    assert arrives and way[:, 2].min() < -0.5, "under the wall"
    way, arrives = found(filled(points), start, goal, keep=0.3, floor=-0.3)
    assert not arrives and way[:, 2].min() >= -0.3


def test_moving_obstacles_are_avoided_at_their_predicted_position() -> None:
    """A ball that crosses the line: when the vehicle is there the ball is, too."""
    grid = filled(np.zeros((0, 3)))
    start, goal = np.array([-2.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.0])
    crossing = Movers(
        np.array([[0.0, -2.0, 0.0]]),
        np.array([[0.0, 1.0, 0.0]]),
        np.array([0.5]),
        0.0,
        np.zeros(1, np.int64),
    )
    way, arrives = found(grid, start, goal, keep=0.3, movers=crossing)
    assert arrives
    times = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))))
    ball = crossing.p_W + times[:, None] * crossing.v_W
    assert np.linalg.norm(way - ball, axis=1).min() > 0.4
    # Nor do straight lines instead of it lead where it will be.
    corners = shortened(grid, way, 0.3, 1.0, crossing)
    assert 2 < len(corners) < len(way)
    along = [a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in pairwise(corners)]
    places = np.vstack(along)
    times = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))))
    ball = crossing.p_W + times[:, None] * crossing.v_W
    assert np.linalg.norm(places - ball, axis=1).min() > 0.4
    gone = crossing._replace(v_W=np.array([[0.0, -1.0, 0.0]]))
    straight, _ = found(grid, start, goal, keep=0.3, movers=gone)
    assert np.abs(straight[:, 1]).max() < 0.21

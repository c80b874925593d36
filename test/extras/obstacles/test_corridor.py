# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Corridors by brute force: each holds its guide and no inflated point."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.obstacles.corridor import REACH, corridor_about


def distances_to_segment(points: Array, start: Array, end: Array) -> Array:
    """Return the distances (n,) of points to a segment, by many places on it."""
    places = start + np.linspace(0.0, 1.0, 2001)[:, None] * (end - start)
    return np.array([np.linalg.norm(places - point, axis=1).min() for point in points])


def case(seed: int, *, radius: float) -> tuple[Array, Array]:
    """Return a guide (7, 3) and points (n, 3), none of which is nearer than the radius to it."""
    rng = np.random.default_rng(seed)
    guide = np.cumsum(rng.uniform(-0.5, 0.8, size=(7, 3)), axis=0)
    points = guide.mean(axis=0) + rng.normal(scale=1.5, size=(120, 3))
    kept = [
        point
        for point in points
        if min(distances_to_segment(point[None], a, b)[0] for a, b in pairwise(guide))
        > radius + 1e-3
    ]
    return guide, np.array(kept)


@pytest.mark.parametrize("seed", range(8))
def test_every_corridor_contains_its_path_and_no_inflated_point(seed: int) -> None:
    radius = 0.3
    guide, points = case(seed, radius=radius)
    # As many rows as points: none is left over.
    normals, offsets = corridor_about(guide, points, radius=radius, rows=2 * len(points))
    for i in range(len(normals)):
        used = np.isfinite(offsets[i])
        n, b = normals[i][used], offsets[i][used]
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0)
        # The places that two stages share are in both regions, the middle of each in its own.
        assert (n @ guide[i + 1] <= b + 1e-9).all()
        # No point in reach is within the radius of the region: some plane is so far before it.
        near = distances_to_segment(points, guide[i], guide[i + 1]) < REACH - 0.01
        before = (n @ points[near].T - b[:, None]).max(axis=0)
        assert before.min() >= radius - 1e-9


@pytest.mark.parametrize("seed", range(8))
def test_nearest_point_gives_the_first_plane(seed: int) -> None:
    """By brute force: its normal is along the shortest way, and it is the radius before it."""
    guide, points = case(seed, radius=0.2)
    normals, offsets = corridor_about(guide, points, radius=0.2, rows=8)
    for i in range(len(normals)):
        apart = distances_to_segment(points, guide[i], guide[i + 1])
        nearest = points[apart.argmin()]
        assert normals[i, 0] @ nearest - offsets[i, 0] == pytest.approx(0.2)
        ends = np.array([guide[i], guide[i + 1]])
        room = offsets[i, 0] - (ends @ normals[i, 0]).max()
        assert room == pytest.approx(apart.min() - 0.2, abs=1e-4)


def test_path_too_close_to_a_point_is_pushed_back() -> None:
    guide = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    normals, offsets = corridor_about(guide, np.array([[0.05, 0.2, 0.0]]), radius=0.5, rows=4)
    np.testing.assert_allclose(normals[0, 0], [0.0, 1.0, 0.0], atol=1e-12)
    assert offsets[0, 0] == pytest.approx(-0.3)


def test_point_on_the_path_defines_a_plane() -> None:
    guide = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    normals, offsets = corridor_about(guide, np.array([[0.5, 0.0, 0.0]]), radius=0.3, rows=4)
    assert np.linalg.norm(normals[0, 0]) == pytest.approx(1.0)
    assert np.isfinite(offsets[0, 0])


def test_no_points_give_no_half_spaces() -> None:
    normals, offsets = corridor_about(np.zeros((4, 3)), np.zeros((0, 3)), radius=0.3, rows=8)
    assert normals.shape == (3, 8, 3)
    assert np.isinf(offsets).all()

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Points on the walls of the volume of flight."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.extras.obstacles.surfaces import wall_points
from quad_mpc_ros.simulation.shapes import Volume


@pytest.mark.parametrize("floor", [0.0, 1.0])
def test_floor_below_a_standing_vehicle_is_not_a_wall(floor: float) -> None:
    volume = Volume(minimum=np.array([0.0, 0.0, floor]), maximum=np.array([4.0, 6.0, 3.0]))
    points = wall_points(volume, 0.1, near=np.array([2.0, 3.0, 2.0]), radius=9.0)
    inside = (points[:, :2] > 0.05).all(axis=1) & (points[:, :2] < [3.95, 5.95]).all(axis=1)
    assert set(points[inside, 2].round(6)) == ({1.0, 3.0} if floor else {3.0})
    assert np.abs(volume.distance(points)).max() < 1e-6


def test_walls_are_sampled_around_the_requested_position() -> None:
    volume = Volume(minimum=np.zeros(3), maximum=np.array([1e3, 1e3, 50.0]))
    near = np.array([2.0, 500.0, 10.0])
    points = wall_points(volume, 0.1, near=near, radius=5.0)
    assert 9_000 < len(points) < 12_000 and np.abs(points[:, 0]).max() == 0.0
    assert not len(wall_points(volume, 0.1, near=near + 100.0, radius=5.0))

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The edges of what half-spaces leave free, and the corridor as a message."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.messages import cdr
from quad_mpc_ros.messages.corridor import (
    corridor_edges,
    corridor_from_message,
    edges,
    written_corridor,
)
from quad_mpc_ros.messages.topics import CORRIDOR
from quad_mpc_ros.ros.messages import message_in

HERE = np.array([1.0, -2.0, 3.0])
CUT = (np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]), np.array([1.5, 1.4]))


def test_edges_are_on_two_planes_and_inside_of_the_others() -> None:
    normals, offsets = CUT
    ends = edges(normals, offsets, inside=HERE, reach=1.0).reshape(-1, 3)
    assert (ends @ normals.T <= offsets + 1e-6).all()
    assert np.abs(ends - HERE).max() <= 1.0 + 1e-6
    assert np.isclose(ends[:, 0], 1.5).any()


def test_corners_and_edges_are_those_of_the_hull() -> None:
    """Euler: corners - edges + faces = 2, the faces being those of the convex hull."""
    normals, offsets = CUT
    found = edges(normals, offsets, inside=HERE, reach=1.0)
    corners = np.unique(found.reshape(-1, 3).round(6), axis=0)
    faces = np.unique(ConvexHull(corners).equations.round(5), axis=0)
    assert len(corners) - len(found) + len(faces) == 2


def test_no_region_around_an_outside_position() -> None:
    assert len(edges(*CUT, inside=HERE + np.array([1.0, 0.0, 0.0]), reach=1.0)) == 0


def test_corridor_message_round_trip() -> None:
    normals = np.zeros((3, 4, 3))
    normals[..., 0] = 1.0
    offsets = np.full((3, 4), np.inf)
    offsets[0, 1], offsets[2, 0], offsets[2, 3] = 2.5, 1.5, 4.0
    corridor = Corridor(stamp_ns=7, step=0.1, normals=normals, offsets=offsets)
    data = written_corridor(corridor, stamp_ns=9, frame_id="odom")
    found = corridor_from_message(message_in(CORRIDOR, data))
    assert cdr.header_stamp_ns(data) == 9
    assert found["stage"].tolist() == [0, 2, 2] and found["offset"].tolist() == [2.5, 1.5, 4.0]
    assert found["normal_x"].tolist() == [1.0, 1.0, 1.0]
    assert len(corridor_edges(found, np.zeros((4, 3)))) == 12
    empty = written_corridor(None, stamp_ns=9, frame_id="odom")
    none = corridor_from_message(message_in(CORRIDOR, empty))
    assert len(none) == 0 and len(corridor_edges(none, np.zeros((4, 3)))) == 0

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Markers for viewers: positions, sizes and lifetimes."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.messages import STORE
from visualization_msgs.msg import Marker

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages import conversions, markers
from quad_mpc_ros.messages.markers import DrawnFence
from quad_mpc_ros.ros.messages import new_message

SECOND = 1_000_000_000


@pytest.fixture
def odometry() -> OdometrySample:
    """Return a vehicle at (1, 2, 3), rolled by 90 degrees to the right."""
    half = np.sqrt(0.5)
    return OdometrySample(
        stamp_ns=5 * SECOND + 7,
        p_WB=np.array([1.0, 2.0, 3.0]),
        q_WB_xyzw=np.array([half, 0.0, 0.0, half]),
        v_WB_B=np.zeros(3),
        w_WB_B=np.zeros(3),
        frame_id="map",
    )


def in_frame(marker: Marker) -> np.ndarray:
    """Return the points of a marker as a viewer places them."""
    p, q = marker.pose.position, marker.pose.orientation
    rotation = so3.rotation_from_quaternion_xyzw(np.array([q.x, q.y, q.z, q.w]))
    points = np.array([(point.x, point.y, point.z) for point in marker.points])
    return points @ rotation.T + np.array([p.x, p.y, p.z])


def test_lines_are_in_the_frame_of_the_odometry(odometry: OdometrySample) -> None:
    path = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [2.0, 1.0, 1.0], [2.0, 1.0, 2.0]])
    line = markers.line_marker(markers.CORRIDOR, odometry, path, new=new_message)
    assert (line.type, line.action) == (Marker.LINE_LIST, Marker.ADD)
    assert line.header.frame_id == "map"
    assert conversions.nanoseconds(line.header.stamp) == odometry.stamp_ns
    assert in_frame(line) == pytest.approx(path)
    assert line.color.a == 1.0
    assert 0 < conversions.nanoseconds(line.lifetime) <= SECOND


def test_the_fence_is_its_twelve_edges_and_is_closed_by_six_walls(
    odometry: OdometrySample,
) -> None:
    closed = DrawnFence(minimum=(-1.0, -2.0, 0.0), maximum=(3.0, 2.0, 2.5))
    marker = markers.fence_marker(odometry, closed, new=new_message)
    assert marker.header.frame_id == "map"
    edges = in_frame(marker).reshape(-1, 2, 3)
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    assert sorted(lengths) == pytest.approx(4 * [2.5] + 8 * [4.0])
    assert edges.min(axis=(0, 1)) == pytest.approx([-1.0, -2.0, 0.0])
    assert edges.max(axis=(0, 1)) == pytest.approx([3.0, 2.0, 2.5])
    assert closed.is_closed
    assert not DrawnFence().is_closed
    assert not DrawnFence(minimum=(-1.0, -2.0, 0.0)).is_closed


def test_single_point_deletes_the_marker(odometry: OdometrySample) -> None:
    for count in (0, 1):
        points = np.zeros((count, 3))
        line = markers.line_marker(markers.CORRIDOR, odometry, points, new=new_message)
        assert line.action == Marker.DELETE


def test_transform_is_the_pose_of_the_odometry(odometry: OdometrySample) -> None:
    message = STORE.types["tf2_msgs/msg/TFMessage"](transforms=[])
    conversions.fill_transform(message, odometry, new=new_message)
    (stamped,) = message.transforms
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", "base_link")
    assert stamped.transform.translation.z == 3.0
    assert stamped.transform.rotation.x == stamped.transform.rotation.w > 0.7

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What viewers are shown: where it stands, how large it is, and when it vanishes."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.messages import STORE
from visualization_msgs.msg import Marker

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.messages import conversions, markers
from quad_mpc_ros.messages.markers import DrawnFence, Trail
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


def test_hover_thrust_is_an_arrow_of_the_given_length(odometry: OdometrySample) -> None:
    vehicle = Vehicle()
    hover = vehicle.hover_throttle
    arrow = markers.thrust_marker(odometry, hover, vehicle, length=0.3, new=new_message)
    assert arrow.type == Marker.ARROW
    tail, tip = in_frame(arrow)
    assert tail == pytest.approx([1.0, 2.0, 3.0])
    # Rolled about the nose by +90 degrees in FLU, up points to the right: -y.
    assert tip - tail == pytest.approx([0.0, -0.3, 0.0])


def test_vehicle_marker_is_at_its_position(odometry: OdometrySample) -> None:
    drawn = markers.vehicle_marker(odometry, arm=0.2, new=new_message)
    assert drawn.type == Marker.LINE_LIST
    assert len(drawn.points) % 2 == 0
    points = in_frame(drawn) - odometry.p_WB
    # Beams of 0.4 m across, rotors of 0.12 m beyond; flat in the body's plane, here x-z.
    assert np.linalg.norm(points, axis=1).max() == pytest.approx(0.32)
    assert np.linalg.norm(points[0] - points[1]) == pytest.approx(0.4)
    assert np.abs(points[:, 1]).max() < 1e-12


def test_lines_are_in_the_frame_of_the_odometry(odometry: OdometrySample) -> None:
    path = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [2.0, 1.0, 1.0]])
    for look in (markers.TRAIL, markers.PREDICTED):
        line = markers.line_marker(look, odometry, path, new=new_message)
        assert (line.type, line.action) == (Marker.LINE_STRIP, Marker.ADD)
        assert line.header.frame_id == "map"
        assert conversions.nanoseconds(line.header.stamp) == odometry.stamp_ns
        assert in_frame(line) == pytest.approx(path)
        assert line.color.a == 1.0


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
        line = markers.line_marker(markers.TRAIL, odometry, np.zeros((count, 3)), new=new_message)
        assert line.action == Marker.DELETE


def test_thrust_and_plan_have_a_lifetime(odometry: OdometrySample) -> None:
    path = np.zeros((2, 3))
    fleeting = [
        markers.line_marker(markers.PREDICTED, odometry, path, new=new_message),
        markers.thrust_marker(odometry, 0.3, Vehicle(), length=1.0, new=new_message),
    ]
    staying = [
        markers.line_marker(markers.TRAIL, odometry, path, new=new_message),
        markers.vehicle_marker(odometry, arm=0.1, new=new_message),
    ]
    assert all(0 < conversions.nanoseconds(marker.lifetime) <= SECOND for marker in fleeting)
    assert not any(conversions.nanoseconds(marker.lifetime) for marker in staying)
    names = {marker.ns for marker in fleeting + staying}
    assert len(names) == 4  # or one would replace the other


def test_trail_drops_old_positions(odometry: OdometrySample) -> None:
    trail = Trail(duration=2.0, spacing=0.1)
    assert trail.p_WB.shape == (0, 3)
    for tick in range(500):  # 10 s at 50 Hz
        trail.add(tick * SECOND // 50, np.array([float(tick), 0.0, 0.0]))
    assert trail.p_WB[:, 0].tolist() == list(range(400, 500, 5))
    trail.add(0, np.array([9.0, 9.0, 9.0]))  # another flight
    assert trail.p_WB.tolist() == [[9.0, 9.0, 9.0]]


def test_transform_is_the_pose_of_the_odometry(odometry: OdometrySample) -> None:
    message = STORE.types["tf2_msgs/msg/TFMessage"](transforms=[])
    conversions.fill_transform(message, odometry, new=new_message)
    (stamped,) = message.transforms
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", "base_link")
    assert stamped.transform.translation.z == 3.0
    assert stamped.transform.rotation.x == stamped.transform.rotation.w > 0.7

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Clouds, markers, plans and transforms from messages of other writers, and from broken ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fixtures.messages import STORE, encoded, encoded_by_rosbags
from numpy.typing import NDArray

from quad_mpc_ros.messages.conversions import fill_quaternion, fill_time, fill_vector
from quad_mpc_ros.messages.obstacle_messages import (
    CUBE,
    markers_from_message,
    transforms_from_message,
)
from quad_mpc_ros.messages.point_cloud import (
    PointCloud,
    point_cloud_from_message,
    written_point_cloud,
)
from quad_mpc_ros.messages.topics import OBSTACLES
from quad_mpc_ros.ros.messages import message_class, message_in, new_message

CLOUD, MARKERS = "sensor_msgs/msg/PointCloud2", "visualization_msgs/msg/MarkerArray"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
T = STORE.types
KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
RANDOM = np.random.default_rng(4)


def header(frame_id: str = "odom", sec: int = 12, nanosec: int = 345) -> Any:
    stamp = T["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def cloud_message(
    points: NDArray[Any], *, shape: tuple[int, int], big_endian: bool, padding: int
) -> Any:
    """Return a cloud of the fields of a structured array (n,), with bytes behind each row."""
    height, width = shape
    step, row_step = points.dtype.itemsize, width * points.dtype.itemsize + padding
    rows = np.zeros((height, row_step), np.uint8)
    rows[:, : width * step] = points.view(np.uint8).reshape(height, width * step)
    types = {np.dtype(kind).newbyteorder("=").str[1:]: number for number, kind in KINDS.items()}
    fields = [
        T["sensor_msgs/msg/PointField"](
            name=name,
            offset=offset,
            datatype=types[dtype.newbyteorder("=").str[1:]],
            count=1,
        )
        for name, (dtype, offset) in points.dtype.fields.items()  # type: ignore[union-attr]
    ]
    return T[CLOUD](
        header=header("camera"),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=big_endian,
        point_step=step,
        row_step=row_step,
        data=rows.ravel(),
        is_dense=False,
    )


@pytest.mark.parametrize("kind", KINDS.values())
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("layout", ["plain", "reversed and far apart"])
def test_every_layout_of_a_cloud_is_read(kind: str, order: str, layout: str) -> None:
    count, dtype = 60, f"{order}{kind}"
    if layout == "plain":
        fields = np.dtype([("x", dtype), ("y", dtype), ("z", dtype), ("intensity", "f4")])
    else:
        offsets = {"names": ["ring", "z", "y", "x"], "formats": ["u2", dtype, dtype, dtype]}
        fields = np.dtype({**offsets, "offsets": [1, 37, 21, 5], "itemsize": 50})
    points = np.zeros(count, fields)
    for axis in "xyz":
        points[axis] = RANDOM.integers(0, 100, count)
    message = cloud_message(points, shape=(5, 12), big_endian=order == ">", padding=7)
    cloud = point_cloud_from_message(message)
    expected = np.column_stack([points[axis].astype(float) for axis in "xyz"])
    assert np.array_equal(cloud.p_SQ, expected)
    assert (cloud.stamp_ns, cloud.frame_id) == (12_000_000_345, "camera")


def test_nonfinite_points_are_omitted() -> None:
    points = RANDOM.normal(size=(50, 3)).astype(np.float32)
    points[3, 0], points[7, 1], points[9, 2], points[11, 0] = np.nan, np.inf, -np.inf, 1e9
    data = written_point_cloud(PointCloud(stamp_ns=1, frame_id="odom", p_SQ=points))
    cloud = point_cloud_from_message(message_in(OBSTACLES, data))
    assert np.array_equal(cloud.p_SQ, np.delete(points, [3, 7, 9, 11], axis=0))


def test_written_clouds_are_read_by_other_readers() -> None:
    points = RANDOM.normal(size=(7, 3))
    data = written_point_cloud(PointCloud(stamp_ns=-1, frame_id="base_link", p_SQ=points))
    message = STORE.deserialize_cdr(data, CLOUD)
    assert encoded_by_rosbags(CLOUD, message) == data
    assert np.allclose(message.data.view("<f4").reshape(-1, 3), points)
    assert encoded(message_class(CLOUD)())  # and it is one of rclpy's types


def test_empty_cloud_is_valid() -> None:
    empty = PointCloud(stamp_ns=5, frame_id="odom", p_SQ=np.zeros((0, 3)))
    data = written_point_cloud(empty)
    assert point_cloud_from_message(message_in(OBSTACLES, data)).p_SQ.shape == (0, 3)
    assert point_cloud_from_message(new_message(CLOUD)).p_SQ.shape == (0, 3)


def changed_cloud(**fields: Any) -> Any:
    points = np.ones(6, np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4")]))
    message = cloud_message(points, shape=(1, 6), big_endian=False, padding=0)
    for name, value in fields.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (changed_cloud(width=7), "a cloud of 1 rows of 7 points"),
        (changed_cloud(height=2**31, width=2**31), "a cloud of 2147483648 rows"),
        (changed_cloud(point_step=8), "z ends beyond the 8 bytes"),
        (changed_cloud(fields=[]), "without x, y, z"),
        (changed_cloud(data=np.full(72, 255, np.uint8)), "6 points, none of them finite"),
    ],
)
def test_unusable_cloud_is_rejected_in_one_line(message: Any, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as caught:
        point_cloud_from_message(message)
    assert "\n" not in str(caught.value)


def test_markers_are_read_one_after_another() -> None:
    message = new_message(MARKERS)
    for number in range(3):
        marker = new_message("visualization_msgs/msg/Marker")
        marker.header.frame_id, marker.header.stamp.sec = "map", 12
        marker.ns, marker.id, marker.type, marker.action = "n", -number, CUBE, number
        fill_vector(marker.pose.position, RANDOM.normal(size=3))
        fill_quaternion(marker.pose.orientation, RANDOM.normal(size=4))
        fill_vector(marker.scale, RANDOM.normal(size=3))
        fill_time(marker.lifetime, 10**9 * number + 5)
        message.markers.append(marker)
    for number, (read, marker) in enumerate(
        zip(markers_from_message(message), message.markers, strict=True)
    ):
        assert (read.name, read.frame_id) == (("n", -number), "map")
        assert (read.kind, read.action, read.stamp_ns) == (CUBE, number, 12 * 10**9)
        assert read.lifetime_ns == number * 10**9 + 5
        pose, scale = marker.pose, marker.scale
        assert read.p.tolist() == [pose.position.x, pose.position.y, pose.position.z]
        assert read.q_xyzw[3] == pose.orientation.w
        assert read.scale.tolist() == [scale.x, scale.y, scale.z]


def test_transforms_are_read_without_the_old_slash() -> None:
    moved = T["geometry_msgs/msg/Transform"](
        T["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0),
        T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8),
    )
    stamped = T["geometry_msgs/msg/TransformStamped"](header("/base_link"), "/camera", moved)
    (found,) = transforms_from_message(T[TRANSFORMS]([stamped]))
    assert (found.parent, found.child) == ("base_link", "camera")
    assert found.p.tolist() == [1.0, 2.0, 3.0] and found.q_xyzw.tolist() == [0.0, 0.0, 0.6, 0.8]

# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages as bytes: what rclpy writes is read, what is written is rclpy's, nothing read wrong."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.messages import STORE, encoded, encoded_by_rosbags
from fixtures.windows import window_through
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message

from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
)
from quad_mpc_ros.messages import cdr, conversions, diagnostics
from quad_mpc_ros.messages.obstacle_messages import path_from_message
from quad_mpc_ros.messages.topics import (
    BATTERY,
    COMMAND,
    IMU,
    ODOMETRY,
    PREDICTED_PATH,
    REFERENCE,
    STATS,
    Topic,
)
from quad_mpc_ros.ros.messages import message_class

NUMBERS = st.floats(allow_nan=False, width=64)
STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=40)


def arrays(*shape: int) -> st.SearchStrategy[np.ndarray]:
    size = int(np.prod(shape))
    return st.lists(NUMBERS, min_size=size, max_size=size).map(
        lambda values: np.array(values).reshape(shape)
    )


ODOMETRIES = st.builds(
    OdometrySample,
    stamp_ns=STAMPS,
    p_WB=arrays(3),
    q_WB_xyzw=arrays(4),
    v_WB_B=arrays(3),
    w_WB_B=arrays(3),
    frame_id=TEXTS,
    child_frame_id=TEXTS,
    v_variance=st.sampled_from((0.0, 0.3)),
)
COMMANDS = st.builds(
    CommandSample, stamp_ns=STAMPS, throttle=NUMBERS, w_WB_B=arrays(3), frame_id=TEXTS
)


@st.composite
def windows(draw: st.DrawFn) -> ReferenceWindow:
    count = draw(st.integers(1, 5))
    offsets = st.lists(st.integers(0, 2**31 * 10**9 - 1), min_size=count, max_size=count)
    return ReferenceWindow(
        stamp_ns=draw(STAMPS),
        frame_id=draw(TEXTS),
        offset_ns=np.array(draw(offsets), dtype=np.int64),
        p_WB=draw(arrays(count, 3)),
        q_WB_xyzw=draw(arrays(count, 4)),
        v_WB_W=draw(arrays(count, 3)),
        a_WB_W=draw(arrays(count, 3)),
        w_WB_W=draw(arrays(count, 3)),
    )


def assert_same(one: Any, other: Any) -> None:
    assert type(one) is type(other)
    for name, value in vars(one).items():
        theirs = getattr(other, name)
        if isinstance(value, np.ndarray):
            assert theirs.dtype == value.dtype and theirs.tobytes() == value.tobytes(), name
            assert theirs.flags.carray, name
        else:
            assert type(theirs) is type(value) and theirs == value, name


def decoded(data: bytes, topic: Topic) -> Any:
    """Return a message as rosbags decodes it, and hold that rosbags encodes it so."""
    message = STORE.deserialize_cdr(data, topic.type_name)
    assert encoded_by_rosbags(topic.type_name, message) == data
    return message


def swapped(message: Any, topic: Topic) -> bytes:
    """Return a message in the other order of bytes."""
    return bytes(STORE.serialize_cdr(message, topic.type_name, little_endian=False))


@given(ODOMETRIES)
def test_odometry(odometry: OdometrySample) -> None:
    data = cdr.written_odometry(odometry)
    message = decoded(data, ODOMETRY)
    assert_same(conversions.odometry_from_message(message), odometry)
    assert cdr.read_odometry(swapped(message, ODOMETRY)) is None  # left to rclpy
    for each in (data, data + b"more"):
        assert_same(cdr.read_odometry(each), odometry)


@given(st.builds(ImuSample, stamp_ns=STAMPS, f_B=arrays(3), frame_id=TEXTS))
def test_imu(sample: ImuSample) -> None:
    data = cdr.written_imu(sample)
    message = decoded(data, IMU)
    assert_same(conversions.imu_from_message(message), sample)
    assert message.orientation_covariance[0] == message.angular_velocity_covariance[0] == -1.0
    assert message.linear_acceleration_covariance[0] == 0.0


def test_imu_without_acceleration_is_refused() -> None:
    message = decoded(cdr.written_imu(ImuSample(stamp_ns=1, f_B=np.zeros(3))), IMU)
    message.linear_acceleration_covariance = np.array([-1.0] + 8 * [0.0])
    with pytest.raises(ValueError, match="imu has no acceleration"):
        conversions.imu_from_message(message)


@given(windows(), TEXTS)
def test_reference(window: ReferenceWindow, child_frame_id: str) -> None:
    data = cdr.written_reference(window, child_frame_id=child_frame_id)
    message = decoded(data, REFERENCE)
    assert message.joint_names == [child_frame_id]
    assert_same(conversions.reference_from_message(message), window)
    assert cdr.read_reference(swapped(message, REFERENCE)) is None  # left to rclpy
    for each in (data, data + b"more"):
        assert_same(cdr.read_reference(each), window)


@given(COMMANDS)
def test_command(command: CommandSample) -> None:
    message = decoded(cdr.written_command(command), COMMAND)
    assert_same(conversions.command_from_message(message), command)


@given(windows(), st.integers(0, 10**9))
def test_path(window: ReferenceWindow, step_ns: int) -> None:
    stamp_ns = min(window.stamp_ns, 2 * 10**18)
    data = cdr.written_path(
        stamp_ns=stamp_ns,
        step_ns=step_ns,
        frame_id=window.frame_id,
        p_WB=window.p_WB,
        q_WB_xyzw=window.q_WB_xyzw,
    )
    message = decoded(data, PREDICTED_PATH)
    assert conversions.positions_from_path(message).tobytes() == window.p_WB.tobytes()
    for k, pose in enumerate(message.poses):
        assert conversions.nanoseconds(pose.header.stamp) == stamp_ns + k * step_ns
        assert pose.header.frame_id == message.header.frame_id == window.frame_id
        q = pose.pose.orientation
        assert [q.x, q.y, q.z, q.w] == window.q_WB_xyzw[k].tolist()
    assert cdr.header_stamp_ns(data) == stamp_ns
    path = path_from_message(message)
    assert (path.stamp_ns, path.frame_id) == (stamp_ns, window.frame_id)
    assert path.times_ns.tolist() == [stamp_ns + k * step_ns for k in range(len(window.p_WB))]


@given(STAMPS, TEXTS, TEXTS, st.lists(st.tuples(TEXTS, TEXTS), max_size=6))
def test_diagnostics(stamp_ns: int, name: str, text: str, values: list[tuple[str, str]]) -> None:
    data = cdr.written_diagnostics(
        stamp_ns=stamp_ns,
        level=diagnostics.WARN,
        name=name,
        text=text,
        values=values,
        hardware_id=text,
    )
    message = decoded(data, STATS)
    (status,) = message.status
    assert conversions.nanoseconds(message.header.stamp) == stamp_ns
    assert (status.level, status.name, status.message) == (1, name, text)
    assert status.hardware_id == text
    assert [(pair.key, pair.value) for pair in status.values] == values


@given(st.floats(width=32), STAMPS)
def test_battery(voltage: float, stamp_ns: int) -> None:
    message = decoded(cdr.written_battery(voltage, stamp_ns=stamp_ns), BATTERY)
    assert message.voltage == voltage or math.isnan(voltage)
    assert message.present
    assert math.isnan(message.temperature) and math.isnan(message.percentage)
    assert conversions.nanoseconds(message.header.stamp) == stamp_ns


@given(windows())
def test_leaves_unusual_points_to_rclpy(window: ReferenceWindow) -> None:
    whole = cdr.written_reference(window, child_frame_id="b")
    for field in ("transforms", "velocities", "accelerations"):
        for place in {0, len(window.p_WB) - 1}:
            for count in (0, 2):
                message = decoded(whole, REFERENCE)
                elements = getattr(message.points[place], field)
                setattr(message.points[place], field, [*elements, *elements][:count])
                assert cdr.read_reference(encoded_by_rosbags(REFERENCE.type_name, message)) is None
    message = decoded(whole, REFERENCE)
    message.points = []
    assert cdr.read_reference(encoded_by_rosbags(REFERENCE.type_name, message)) is None


@settings(max_examples=300)
@given(st.data())
def test_damaged_bytes_are_read_like_rosbags_or_left_to_rclpy(data: st.DataObject) -> None:
    """Cut, or with bytes turned: never another message than an independent decoder finds."""
    odometry = OdometrySample.at_rest([1.0, 2.0, 3.0], yaw=0.5, stamp_ns=7)
    window = ReferenceWindow.hover([1.0, 2.0, 3.0])
    for topic, whole, read, convert in (
        (
            ODOMETRY,
            cdr.written_odometry(odometry),
            cdr.read_odometry,
            conversions.odometry_from_message,
        ),
        (
            REFERENCE,
            cdr.written_reference(window, child_frame_id="b"),
            cdr.read_reference,
            conversions.reference_from_message,
        ),
    ):
        spoilt = bytearray(whole[: data.draw(st.integers(0, len(whole)))])
        for _ in range(data.draw(st.integers(0, 3))):
            if spoilt:
                place = data.draw(st.integers(0, min(len(spoilt), 60) - 1))
                spoilt[place] = data.draw(st.integers(0, 255))
        found = read(bytes(spoilt))
        if found is not None:
            assert_same(found, convert(STORE.deserialize_cdr(bytes(spoilt), topic.type_name)))


@pytest.mark.parametrize("read", [cdr.read_odometry, cdr.read_reference])
@pytest.mark.parametrize("kind", [b"\x00\x02", b"\x00\x03", b"\x00\x07", b"\x01\x00", b"", b"\0"])
def test_leaves_other_encapsulations_to_rclpy(read: Callable[..., Any], kind: bytes) -> None:
    assert read(kind + cdr.written_odometry(OdometrySample.at_rest([0, 0, 0]))[2:]) is None
    assert read(kind) is None


def gaps(data: bytes, ours: bytes) -> list[int]:
    return [place for place, (a, b) in enumerate(zip(data, ours, strict=True)) if a != b]


def test_bytes_equal_rclpys_except_for_gaps() -> None:
    random = np.random.default_rng(1)
    window = window_through(np.arange(7) * 0.2, random.normal(size=(7, 3)), stamp_ns=9)
    odometry = OdometrySample.at_rest([1.0, 2.0, 3.0], yaw=0.5, stamp_ns=7, frame_id="map")
    command = CommandSample(stamp_ns=3, throttle=0.3, w_WB_B=np.array([1.0, -2.0, 3.0]))
    path = cdr.written_path(
        stamp_ns=5, step_ns=7, frame_id="odom", p_WB=window.p_WB, q_WB_xyzw=window.q_WB_xyzw
    )
    for topic, ours in (
        (ODOMETRY, cdr.written_odometry(odometry)),
        (COMMAND, cdr.written_command(command)),
        (REFERENCE, cdr.written_reference(window, child_frame_id="base")),
        (PREDICTED_PATH, path),
        (BATTERY, cdr.written_battery(15.5, stamp_ns=3)),
    ):
        theirs = encoded(deserialize_message(ours, message_class(topic.type_name)))
        assert all(ours[place] == 0 for place in gaps(theirs, ours))
        assert len(gaps(theirs, ours)) <= len(ours) // 12 + 8


def test_leaves_a_text_without_its_end_to_rclpy() -> None:
    data = bytearray(cdr.written_odometry(OdometrySample.at_rest([1.0, 2.0, 3.0])))
    struct.pack_into("<I", data, 12, 0)
    assert cdr.read_odometry(bytes(data)) is None


@pytest.mark.parametrize("data", [b"", b"\0", b"\x00\x01\x00\x00short"])
def test_refuses_a_stamp_of_too_few_bytes(data: bytes) -> None:
    with pytest.raises(ValueError, match="no stamp"):
        cdr.header_stamp_ns(data)

"""Messages as bytes: what rclpy writes is read, what is written is rclpy's, nothing read wrong."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.messages import cdr, conversions, diagnostics
from quad_mpc_ros.messages.codec import RosbagsMessages
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY, PREDICTED_PATH, REFERENCE, STATS

MESSAGES = RosbagsMessages()

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


def made(type_name: str, fill: Callable[[Any], None]) -> Any:
    message = MESSAGES.new(type_name)
    fill(message)
    return message


def assert_same(one: Any, other: Any) -> None:
    assert type(one) is type(other)
    for name, value in vars(one).items():
        theirs = getattr(other, name)
        if isinstance(value, np.ndarray):
            assert theirs.dtype == value.dtype and theirs.tobytes() == value.tobytes(), name
            assert theirs.flags.carray, name
        else:
            assert type(theirs) is type(value) and theirs == value, name


def turned(data: bytes, type_name: str) -> bytes:
    """Return a message with the other byte first."""
    message = MESSAGES.decode(type_name, data)
    store = get_typestore(Stores.ROS2_JAZZY)
    return bytes(store.serialize_cdr(message, type_name, little_endian=False))


@given(ODOMETRIES)
def test_odometry(odometry: OdometrySample) -> None:
    message = made(ODOMETRY.type_name, lambda m: conversions.fill_odometry(m, odometry))
    data = MESSAGES.encode(ODOMETRY.type_name, message)
    assert cdr.written_odometry(odometry) == data
    for each in (data, turned(data, ODOMETRY.type_name), data + b"more"):
        assert_same(cdr.read_odometry(each), conversions.odometry_from_message(message))


@given(windows(), TEXTS)
def test_reference(window: ReferenceWindow, child_frame_id: str) -> None:
    message = made(
        REFERENCE.type_name,
        lambda m: conversions.fill_reference(
            m, window, child_frame_id=child_frame_id, new=MESSAGES.new
        ),
    )
    data = MESSAGES.encode(REFERENCE.type_name, message)
    assert cdr.written_reference(window, child_frame_id=child_frame_id) == data
    for each in (data, turned(data, REFERENCE.type_name), data + b"more"):
        assert_same(cdr.read_reference(each), conversions.reference_from_message(message))


@given(COMMANDS)
def test_command(command: CommandSample) -> None:
    message = made(COMMAND.type_name, lambda m: conversions.fill_command(m, command))
    assert cdr.written_command(command) == MESSAGES.encode(COMMAND.type_name, message)


@given(windows(), st.integers(0, 10**9))
def test_path(window: ReferenceWindow, step_ns: int) -> None:
    values = {
        "stamp_ns": min(window.stamp_ns, 2 * 10**18),
        "step_ns": step_ns,
        "frame_id": window.frame_id,
        "p_WB": window.p_WB,
        "q_WB_xyzw": window.q_WB_xyzw,
    }
    message = made(
        PREDICTED_PATH.type_name, lambda m: conversions.fill_path(m, **values, new=MESSAGES.new)
    )
    assert cdr.written_path(**values) == MESSAGES.encode(PREDICTED_PATH.type_name, message)


@given(STAMPS, TEXTS, TEXTS, st.lists(st.tuples(TEXTS, TEXTS), max_size=6))
def test_diagnostics(stamp_ns: int, name: str, text: str, values: list[tuple[str, str]]) -> None:
    message = MESSAGES.new(STATS.type_name)
    conversions.fill_time(message.header.stamp, stamp_ns)
    status = MESSAGES.new("diagnostic_msgs/msg/DiagnosticStatus")
    told = {"name": name, "level": diagnostics.WARN, "text": text, "values": values}
    diagnostics.fill_status(status, **told, new=MESSAGES.new)
    message.status = [status]
    data = cdr.written_diagnostics(stamp_ns=stamp_ns, **told)
    assert data == MESSAGES.encode(STATS.type_name, message)


@given(windows())
def test_points_of_another_make_are_left_to_rclpy(window: ReferenceWindow) -> None:
    def fill(message: Any) -> None:
        conversions.fill_reference(message, window, child_frame_id="b", new=MESSAGES.new)

    for field in ("transforms", "velocities", "accelerations"):
        for place in {0, len(window.p_WB) - 1}:
            for count in (0, 2):
                message = made(REFERENCE.type_name, fill)
                elements = getattr(message.points[place], field)
                setattr(message.points[place], field, [*elements, *elements][:count])
                assert cdr.read_reference(MESSAGES.encode(REFERENCE.type_name, message)) is None
    message = made(REFERENCE.type_name, fill)
    message.points = []
    assert cdr.read_reference(MESSAGES.encode(REFERENCE.type_name, message)) is None


@settings(max_examples=300)
@given(st.data())
def test_spoilt_bytes_are_read_as_rosbags_reads_them_or_left_alone(data: st.DataObject) -> None:
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
            assert_same(found, convert(MESSAGES.decode(topic.type_name, bytes(spoilt))))


@pytest.mark.parametrize("read", [cdr.read_odometry, cdr.read_reference])
@pytest.mark.parametrize("kind", [b"\x00\x02", b"\x00\x03", b"\x00\x07", b"\x01\x00", b"", b"\0"])
def test_other_encapsulations_are_left_to_rclpy(read: Callable[..., Any], kind: bytes) -> None:
    assert read(kind + cdr.written_odometry(OdometrySample.at_rest([0, 0, 0]))[2:]) is None
    assert read(kind) is None


def test_long_texts(length: int = 70_000) -> None:
    odometry = OdometrySample.at_rest([0.0, 0.0, 1.0], frame_id="x" * length)
    found = cdr.read_odometry(cdr.written_odometry(odometry))
    assert found is not None and found.frame_id == odometry.frame_id


def gaps(data: bytes, ours: bytes) -> list[int]:
    return [place for place, (a, b) in enumerate(zip(data, ours, strict=True)) if a != b]


def test_rclpy_writes_the_same_but_for_gaps_and_reads_ours() -> None:
    serialization = pytest.importorskip("rclpy.serialization")
    from quad_mpc_ros.ros.messages import message_class, new_message

    random = np.random.default_rng(1)
    window = ReferenceWindow.through(np.arange(7) * 0.2, random.normal(size=(7, 3)), stamp_ns=9)
    odometry = OdometrySample.at_rest([1.0, 2.0, 3.0], yaw=0.5, stamp_ns=7, frame_id="map")
    command = CommandSample(stamp_ns=3, throttle=0.3, w_WB_B=np.array([1.0, -2.0, 3.0]))
    path = {"stamp_ns": 5, "step_ns": 7, "frame_id": "odom"}
    path |= {"p_WB": window.p_WB, "q_WB_xyzw": window.q_WB_xyzw}
    for topic, ours, fill in (
        (
            ODOMETRY,
            cdr.written_odometry(odometry),
            lambda m: conversions.fill_odometry(m, odometry),
        ),
        (COMMAND, cdr.written_command(command), lambda m: conversions.fill_command(m, command)),
        (
            REFERENCE,
            cdr.written_reference(window, child_frame_id="base"),
            lambda m: conversions.fill_reference(
                m, window, child_frame_id="base", new=new_message
            ),
        ),
        (
            PREDICTED_PATH,
            cdr.written_path(**path),
            lambda m: conversions.fill_path(m, **path, new=new_message),
        ),
    ):
        message = new_message(topic.type_name)
        fill(message)
        theirs = bytes(serialization.serialize_message(message))
        assert all(ours[place] == 0 for place in gaps(theirs, ours))
        assert len(gaps(theirs, ours)) <= len(ours) // 12 + 8
        assert serialization.deserialize_message(ours, message_class(topic.type_name)) == message
    data = bytearray(cdr.written_odometry(odometry))
    struct.pack_into("<I", data, 12, 0)  # a text without even its end
    assert cdr.read_odometry(bytes(data)) is None

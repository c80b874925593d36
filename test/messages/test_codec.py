"""The codec against rclpy's generated classes and Fast CDR, through the public interface."""

from __future__ import annotations

import importlib
import math
import random
import string
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.codec import RosbagsMessages
from quad_mpc_ros.messages.schemas import SHIPPED_TYPES, MessageSchema

CODEC = RosbagsMessages()
SHARE = Path(sys.prefix) / "share"


def rclpy_class(type_name: str) -> Any:
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def fill(ours: Any, theirs: Any, rng: random.Random) -> None:
    """Set every field of both messages to the same random value, by the same assignments."""
    for name, kind in theirs.get_fields_and_field_types().items():
        if kind.startswith("sequence<"):
            element = kind.removeprefix("sequence<").removesuffix(">")
            count = rng.randrange(4)
            pairs = [random_value(element, rng) for _ in range(count)]
            setattr(ours, name, [mine for mine, _ in pairs])
            setattr(theirs, name, [other for _, other in pairs])
        elif kind.endswith("]"):
            base, _, length = kind[:-1].partition("[")
            values = [random_value(base, rng)[0] for _ in range(int(length))]
            setattr(ours, name, values)
            setattr(theirs, name, values)
        elif "/" in kind:
            fill(getattr(ours, name), getattr(theirs, name), rng)
        else:
            value, _ = random_value(kind, rng)
            setattr(ours, name, value)
            setattr(theirs, name, value)


def random_value(kind: str, rng: random.Random) -> tuple[Any, Any]:
    if "/" in kind:
        type_name = kind.replace("/", "/msg/")
        ours, theirs = CODEC.new(type_name), rclpy_class(type_name)()
        fill(ours, theirs, rng)
        return ours, theirs
    if kind == "string":
        value: Any = "".join(rng.choices(string.printable + "äπ→𝛚", k=rng.randrange(12)))
    elif kind == "double":
        value = rng.choice([rng.gauss(0, 1e3), 0.0, -0.0, math.inf, 5e-324, 1.7e308])
    elif kind == "float":  # what 32 bits hold
        value = rng.choice([0.25 * rng.randrange(-999, 999), -0.0, math.inf, 2.0**-140])
    elif kind == "boolean":
        value = bool(rng.randrange(2))
    elif kind == "octet":
        value = bytes([rng.randrange(256)])
    else:
        bits, unsigned = int(kind.removeprefix("u").removeprefix("int")), kind[0] == "u"
        value = rng.randrange(2**bits) - (0 if unsigned else 2 ** (bits - 1))
    return value, value


def assert_same_but_for_gaps(ours: bytes, theirs: bytes, message: Any) -> None:
    """Assert that the bytes differ nowhere but in alignment gaps.

    Fast CDR leaves gaps as they are in memory. A byte is in a gap if the message does not change
    when the byte does.
    """
    assert len(ours) == len(theirs)
    for index in (i for i in range(len(ours)) if ours[i] != theirs[i]):
        changed = bytearray(theirs)
        changed[index] ^= 0xFF
        assert deserialize_message(bytes(changed), type(message)) == message
        assert ours[index] == 0


@pytest.mark.parametrize("type_name", SHIPPED_TYPES)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_bytes_are_those_of_rclpy(type_name: str, seed: int) -> None:
    ours, theirs = CODEC.new(type_name), rclpy_class(type_name)()
    fill(ours, theirs, random.Random(seed))
    encoded = CODEC.encode(type_name, ours)
    serialized = serialize_message(theirs)
    assert_same_but_for_gaps(encoded, serialized, theirs)
    assert deserialize_message(encoded, type(theirs)) == theirs
    assert CODEC.encode(type_name, CODEC.decode(type_name, serialized)) == encoded


def installed_message_types() -> list[str]:
    names = sorted(get_typestore(Stores.ROS2_JAZZY).fielddefs)
    return [name for name in names if "/msg/" in name and (SHARE / f"{name}.msg").exists()]


def test_a_new_message_of_any_type_is_rclpys() -> None:
    types = installed_message_types()
    assert len(types) > 150
    for type_name in types:
        message = rclpy_class(type_name)()
        encoded = CODEC.encode(type_name, CODEC.new(type_name))
        serialized = serialize_message(message)
        assert len(serialized) >= len(encoded)
        assert_same_but_for_gaps(encoded, serialized[: len(encoded)], message)
        assert deserialize_message(encoded, type(message)) == message, type_name


def test_a_new_odometry() -> None:
    odometry = CODEC.new("nav_msgs/msg/Odometry")
    assert odometry.pose.pose.orientation.w == 1.0
    assert odometry.pose.pose.orientation.x == 0.0
    assert odometry.header.frame_id == ""
    assert isinstance(odometry.header.stamp.sec, int)
    assert isinstance(odometry.twist.twist.linear.x, float)
    assert odometry.pose.covariance.dtype == np.float64
    assert odometry.pose.covariance.shape == (36,)
    odometry.pose.covariance[7] = 1.0
    assert CODEC.new("nav_msgs/msg/Odometry").pose.covariance[7] == 0.0
    assert odometry.twist.covariance[7] == 0.0


def test_a_new_sequence_is_an_empty_list_of_its_own() -> None:
    first, second = (CODEC.new("diagnostic_msgs/msg/DiagnosticArray") for _ in range(2))
    assert first.status == []
    first.status.append(CODEC.new("diagnostic_msgs/msg/DiagnosticStatus"))
    assert second.status == []
    assert first.status[0].level == b"\x00"


@pytest.mark.parametrize("level", [b"\x02", 2])
def test_a_byte_may_be_given_as_rclpy_or_as_rosbags_have_it(level: bytes | int) -> None:
    status = CODEC.new("diagnostic_msgs/msg/DiagnosticStatus")
    status.level = level
    encoded = CODEC.encode("diagnostic_msgs/msg/DiagnosticStatus", status)
    assert CODEC.decode("diagnostic_msgs/msg/DiagnosticStatus", encoded).level == b"\x02"
    assert status.level == level


@pytest.mark.parametrize(
    "values", [[1.0] * 36, (1.0,) * 36, np.ones(36), np.ones(36, np.float32), np.ones(72)[::2]]
)
def test_an_array_may_be_any_sequence_and_is_left_alone(values: Any) -> None:
    odometry = CODEC.new("nav_msgs/msg/Odometry")
    odometry.pose.covariance = values
    encoded = CODEC.encode("nav_msgs/msg/Odometry", odometry)
    theirs = deserialize_message(encoded, rclpy_class("nav_msgs/msg/Odometry"))
    assert theirs.pose.covariance.tolist() == [1.0] * 36
    assert odometry.pose.covariance is values


def test_a_decoded_message_can_be_changed() -> None:
    encoded = CODEC.encode("nav_msgs/msg/Odometry", CODEC.new("nav_msgs/msg/Odometry"))
    odometry = CODEC.decode("nav_msgs/msg/Odometry", encoded)
    odometry.pose.covariance[0] = 2.0
    assert CODEC.encode("nav_msgs/msg/Odometry", odometry) != encoded


@pytest.mark.parametrize(
    ("field", "value"),
    [("sec", "now"), ("sec", 2**31), ("nanosec", -1), ("sec", None)],
)
def test_a_value_that_does_not_fit_is_refused(field: str, value: object) -> None:
    clock = CODEC.new("rosgraph_msgs/msg/Clock")
    setattr(clock.clock, field, value)
    with pytest.raises(BagError, match="cannot encode a rosgraph_msgs/msg/Clock"):
        CODEC.encode("rosgraph_msgs/msg/Clock", clock)


def test_an_array_of_the_wrong_length_is_refused() -> None:
    odometry = CODEC.new("nav_msgs/msg/Odometry")
    odometry.pose.covariance = [0.0] * 35
    with pytest.raises(BagError, match="length"):
        CODEC.encode("nav_msgs/msg/Odometry", odometry)


def test_unknown_types_are_refused() -> None:
    for attempt in (
        lambda: CODEC.new("px4_msgs/msg/VehicleOdometry"),
        lambda: CODEC.encode("px4_msgs/msg/VehicleOdometry", object()),
        lambda: CODEC.decode("px4_msgs/msg/VehicleOdometry", b""),
    ):
        with pytest.raises(BagError, match="px4_msgs/msg/VehicleOdometry"):
            attempt()


@pytest.mark.parametrize("type_name", SHIPPED_TYPES)
@given(seed=st.integers(0, 2**32), data=st.data())
@settings(max_examples=40, deadline=None)
def test_damaged_bytes_decode_or_are_refused(
    type_name: str, seed: int, data: st.DataObject
) -> None:
    ours, theirs = CODEC.new(type_name), rclpy_class(type_name)()
    fill(ours, theirs, random.Random(seed))
    damaged = bytearray(CODEC.encode(type_name, ours))
    for _ in range(3):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    damaged = damaged[: data.draw(st.integers(0, len(damaged)))]
    try:
        CODEC.decode(type_name, bytes(damaged))
    except BagError as error:
        assert "\n" not in str(error)


def test_a_registered_type_is_encoded_and_decoded() -> None:
    codec = RosbagsMessages()
    codec.register(
        MessageSchema(type_name="lab_msgs/msg/Gains", text="float64[] k\n", type_hash="")
    )
    data = b"\x00\x01\x00\x00" + b"\x01\x00\x00\x00" + bytes(4) + np.float64(2.5).tobytes()
    gains = codec.decode("lab_msgs/msg/Gains", data)
    assert gains.k.tolist() == [2.5]
    gains.k = [2.5]
    assert codec.encode("lab_msgs/msg/Gains", gains) == data


@pytest.mark.parametrize(
    ("type_name", "text"),
    [("std_msgs/msg/Header", "string frame_id\n"), ("lab_msgs/msg/Gains", "float64[ k\n")],
)
def test_a_definition_that_differs_or_is_broken_is_refused(type_name: str, text: str) -> None:
    with pytest.raises(BagError, match=f"schema of {type_name}"):
        RosbagsMessages().register(MessageSchema(type_name=type_name, text=text, type_hash=""))

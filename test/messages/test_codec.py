# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Decoding against rclpy's generated classes and Fast CDR."""

from __future__ import annotations

import math
import random
import string
from typing import Any

import pytest
from fixtures.messages import RECORDED_TYPES, empty, encoded
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.codec import MessageDecoder
from quad_mpc_ros.ros.messages import new_message

DECODER = MessageDecoder()


def random_message(type_name: str, rng: random.Random) -> Any:
    """Return a message of rclpy with a random value in every field."""
    message = new_message(type_name)
    for name, kind in message.get_fields_and_field_types().items():
        if kind.startswith("sequence<"):
            element = kind.removeprefix("sequence<").removesuffix(">")
            value: Any = [random_value(element, rng) for _ in range(rng.randrange(4))]
        elif kind.endswith("]"):
            base, _, length = kind[:-1].partition("[")
            value = [random_value(base, rng) for _ in range(int(length))]
        else:
            value = random_value(kind, rng)
        setattr(message, name, value)
    return message


def random_value(kind: str, rng: random.Random) -> Any:
    if "/" in kind:
        return random_message(kind.replace("/", "/msg/"), rng)
    if kind == "string":
        return "".join(rng.choices(string.printable + "äπ→𝛚", k=rng.randrange(12)))
    if kind == "double":
        return rng.choice([rng.gauss(0, 1e3), 0.0, -0.0, math.inf, 5e-324, 1.7e308])
    if kind == "float":  # what 32 bits hold
        return rng.choice([0.25 * rng.randrange(-999, 999), -0.0, math.inf, 2.0**-140])
    if kind == "boolean":
        return bool(rng.randrange(2))
    if kind == "octet":
        return bytes([rng.randrange(256)])
    bits, unsigned = int(kind.removeprefix("u").removeprefix("int")), kind[0] == "u"
    return rng.randrange(2**bits) - (0 if unsigned else 2 ** (bits - 1))


def plain(value: Any) -> Any:
    """Return a value of either library as one that can be compared."""
    if isinstance(value, bytes):  # the octet of rclpy is a signed integer in rosbags
        return int.from_bytes(value, signed=True)
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(each) for each in value] if isinstance(value, list) else value


def assert_same(ours: Any, theirs: Any) -> None:
    for name in theirs.get_fields_and_field_types():
        mine, other = plain(getattr(ours, name)), plain(getattr(theirs, name))
        nested = other if isinstance(other, list) else [other]
        if nested and hasattr(nested[0], "get_fields_and_field_types"):
            pairs = zip(mine if isinstance(mine, list) else [mine], nested, strict=True)
            for one, another in pairs:
                assert_same(one, another)
        else:
            assert mine == other, name


@pytest.mark.parametrize("type_name", RECORDED_TYPES)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_decodes_what_rclpy_serializes(type_name: str, seed: int) -> None:
    message = random_message(type_name, random.Random(seed))
    assert_same(DECODER.decode(type_name, encoded(message)), message)


def test_decoded_message_is_writable() -> None:
    odometry = DECODER.decode("nav_msgs/msg/Odometry", empty("nav_msgs/msg/Odometry"))
    odometry.pose.covariance[0] = 2.0
    assert odometry.pose.covariance[0] == 2.0


def test_refuses_unknown_types() -> None:
    with pytest.raises(BagError, match="px4_msgs/msg/VehicleOdometry"):
        DECODER.decode("px4_msgs/msg/VehicleOdometry", b"")


@pytest.mark.parametrize("type_name", RECORDED_TYPES)
@given(seed=st.integers(0, 2**32), data=st.data())
@settings(max_examples=40, deadline=None)
def test_damaged_bytes_decode_or_are_refused(
    type_name: str, seed: int, data: st.DataObject
) -> None:
    damaged = bytearray(encoded(random_message(type_name, random.Random(seed))))
    for _ in range(3):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    damaged = damaged[: data.draw(st.integers(0, len(damaged)))]
    try:
        DECODER.decode(type_name, bytes(damaged))
    except BagError as error:
        assert "\n" not in str(error)

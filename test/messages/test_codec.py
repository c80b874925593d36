# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Decoding: unknown types and damaged bytes; the rest is the library rosbags."""

from __future__ import annotations

import pytest
from fixtures.messages import RECORDED_TYPES, empty
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.codec import MessageDecoder

DECODER = MessageDecoder()


def test_decoded_message_is_writable() -> None:
    odometry = DECODER.decode("nav_msgs/msg/Odometry", empty("nav_msgs/msg/Odometry"))
    odometry.pose.covariance[0] = 2.0
    assert odometry.pose.covariance[0] == 2.0


def test_refuses_unknown_types() -> None:
    with pytest.raises(BagError, match="px4_msgs/msg/VehicleOdometry"):
        DECODER.decode("px4_msgs/msg/VehicleOdometry", b"")


@pytest.mark.parametrize("type_name", RECORDED_TYPES)
@given(data=st.binary(max_size=400))
@settings(max_examples=40, deadline=None)
def test_any_bytes_decode_or_are_refused(type_name: str, data: bytes) -> None:
    try:
        DECODER.decode(type_name, empty(type_name)[:4] + data)
    except BagError as error:
        assert "\n" not in str(error)

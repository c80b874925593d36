# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The bridge to PX4 with MAVROS, compared with their documentation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from fixtures.bridges import AXES, T0, command, deliver, ready_to_fly, topics, vector

from quad_mpc_ros.ros.bridges import mavros
from quad_mpc_ros.ros.bridges.mavros import MavrosBridge

New = Callable[[str], Any]

NOW_NS = 5_250_000_000


@pytest.mark.parametrize("axis", AXES)
def test_sends_flu_rates_to_mavros_unchanged(new: New, axis: tuple[float, ...]) -> None:
    message = new("mavros_msgs/msg/AttitudeTarget")
    mavros.fill_attitude_target(message, command(w=axis), throttle=0.42, now_ns=NOW_NS)
    assert vector(message.body_rate) == axis
    assert message.thrust == pytest.approx(0.42)
    # Ignore the attitude, and none of the rates (1, 2, 4) nor the thrust (64).
    assert message.type_mask == 128
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 250_000_000)


def report(bridge: MavrosBridge, new: New, **fields: Any) -> None:
    """Deliver a status of PX4, armed in OFFBOARD except for the given fields."""
    state = new("mavros_msgs/msg/State")
    state.connected, state.mode, state.armed = True, "OFFBOARD", True
    for name, value in fields.items():
        setattr(state, name, value)
    deliver(bridge, "/mavros/state", state, T0)


@pytest.mark.parametrize("left", [{"mode": "AUTO.LOITER"}, {"connected": False}])
def test_setpoints_stop_with_the_first_status_that_px4_left_offboard(
    new: New, left: dict[str, Any]
) -> None:
    bridge = ready_to_fly(MavrosBridge, T0)
    report(bridge, new)
    assert topics(bridge.receive_command(command(T0), now_ns=T0))
    assert bridge.engaged(now_ns=T0)
    report(bridge, new, **left)
    assert not bridge.engaged(now_ns=T0)
    report(bridge, new)  # it does not resume by itself
    assert bridge.receive_command(command(T0), now_ns=T0) == []


def test_requests_hold_mode_at_a_release_and_sends_nothing_afterwards(new: New) -> None:
    bridge = ready_to_fly(MavrosBridge, T0)
    (call,) = bridge.engage(False, now_ns=T0).calls
    assert call.request.custom_mode == "AUTO.LOITER"
    assert bridge.receive_command(command(T0), now_ns=T0) == []

"""MAVROS with PX4 and ArduPilot, against what they document."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from fixtures.bridges import AXES, T0, command, tell, vector

from quad_mpc_ros.bridges import mavros
from quad_mpc_ros.bridges.mavros import MavrosBridge

New = Callable[[str], Any]

NOW_NS = 5_250_000_000


@pytest.mark.parametrize("axis", AXES)
def test_mavros_takes_flu_as_it_is(new: New, axis: tuple[float, ...]) -> None:
    message = new("mavros_msgs/msg/AttitudeTarget")
    mavros.fill_attitude_target(message, command(w=axis), throttle=0.42, now_ns=NOW_NS)
    assert vector(message.body_rate) == axis
    assert message.thrust == pytest.approx(0.42)
    # Ignore the attitude, and none of the rates (1, 2, 4) nor the thrust (64).
    assert message.type_mask == 128
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 250_000_000)


def test_ardupilot_gets_nothing_outside_of_guided(new: New) -> None:
    bridge = MavrosBridge(MavrosBridge.Config(autopilot="ardupilot"), new)
    state = new("mavros_msgs/msg/State")
    for mode, heard in (("LOITER", False), ("GUIDED", True), ("GUIDED_NOGPS", True)):
        state.connected, state.mode = True, mode
        tell(bridge, "/mavros/state", state, T0)
        assert bool(bridge.receive_command(command(T0), now_ns=T0)) is heard
    state.connected = False
    assert bridge.receive_command(command(T0), now_ns=T0) == []

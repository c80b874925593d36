"""MAVROS with PX4 and ArduPilot, against what they document."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from fixtures.bridges import AXES, T0, command, ready_to_fly, tell, topics, vector

from quad_mpc_ros.ros.bridges import mavros
from quad_mpc_ros.ros.bridges.mavros import MavrosBridge

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


def test_sends_ardupilot_nothing_outside_guided(new: New) -> None:
    for mode, heard in (("LOITER", False), ("GUIDED", True), ("GUIDED_NOGPS", True)):
        bridge = ready_to_fly(MavrosBridge, T0, autopilot="ardupilot")
        state = new("mavros_msgs/msg/State")
        state.connected, state.mode, state.armed = True, mode, True
        tell(bridge, "/mavros/state", state, T0)
        targets = topics(bridge.receive_command(command(T0), now_ns=T0))
        assert bool(targets) is heard
        state.connected = False
        assert bridge.receive_command(command(T0), now_ns=T0) == []


def test_ardupilot_setpoints_stop_with_first_status_of_another_mode(
    new: New,
) -> None:
    bridge = ready_to_fly(MavrosBridge, T0, autopilot="ardupilot")
    state = new("mavros_msgs/msg/State")
    state.connected, state.mode, state.armed = True, "GUIDED", True
    tell(bridge, "/mavros/state", state, T0)
    assert bridge.receive_command(command(T0), now_ns=T0)
    assert bridge.engaged(now_ns=T0)
    state.mode = "LOITER"
    tell(bridge, "/mavros/state", state, T0)
    assert not bridge.engaged(now_ns=T0)
    state.mode = "GUIDED"  # and it is not taken up again by itself
    tell(bridge, "/mavros/state", state, T0)
    assert bridge.receive_command(command(T0), now_ns=T0) == []
    # Released on request, it hears nothing from then on, whatever the status says.
    again = ready_to_fly(MavrosBridge, T0, autopilot="ardupilot")
    (call,) = again.engage(False, now_ns=T0).calls
    assert call.request.custom_mode == "LOITER"
    assert again.receive_command(command(T0), now_ns=T0) == []

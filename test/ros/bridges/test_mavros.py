"""The bridge to MAVROS with PX4 and ArduPilot, compared with their documentation."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import NoneType, SimpleNamespace
from typing import Any

import pytest
from fixtures.bridges import (
    AXES,
    SECOND,
    T0,
    command,
    deliver,
    engage,
    message_of,
    ready_to_fly,
    topics,
    vector,
)
from fixtures.stack_messages import sound_message

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


def test_sends_ardupilot_nothing_outside_guided(new: New) -> None:
    for mode, sends in (("LOITER", False), ("GUIDED", True), ("GUIDED_NOGPS", True)):
        bridge = ready_to_fly(MavrosBridge, T0, autopilot="ardupilot")
        state = new("mavros_msgs/msg/State")
        state.connected, state.mode, state.armed = True, mode, True
        deliver(bridge, "/mavros/state", state, T0)
        targets = topics(bridge.receive_command(command(T0), now_ns=T0))
        assert bool(targets) is sends
        state.connected = False
        assert bridge.receive_command(command(T0), now_ns=T0) == []


def test_ardupilot_setpoints_stop_with_first_status_of_another_mode(
    new: New,
) -> None:
    bridge = ready_to_fly(MavrosBridge, T0, autopilot="ardupilot")
    state = new("mavros_msgs/msg/State")
    state.connected, state.mode, state.armed = True, "GUIDED", True
    deliver(bridge, "/mavros/state", state, T0)
    assert bridge.receive_command(command(T0), now_ns=T0)
    assert bridge.engaged(now_ns=T0)
    state.mode = "LOITER"
    deliver(bridge, "/mavros/state", state, T0)
    assert not bridge.engaged(now_ns=T0)
    state.mode = "GUIDED"  # and it is not taken up again by itself
    deliver(bridge, "/mavros/state", state, T0)
    assert bridge.receive_command(command(T0), now_ns=T0) == []
    # After a release on request the bridge sends nothing, whatever the status.
    again = ready_to_fly(MavrosBridge, T0, autopilot="ardupilot")
    (call,) = again.engage(False, now_ns=T0).calls
    assert call.request.custom_mode == "LOITER"
    assert again.receive_command(command(T0), now_ns=T0) == []


def parameters_response(**parameters: int | float | None) -> Any:
    """Return MAVROS's answer: a parameter of each value, not set where it is None."""
    values = [
        SimpleNamespace(
            type={int: 2, float: 3, NoneType: 0}[type(value)],
            integer_value=value if isinstance(value, int) else 0,
            double_value=value if isinstance(value, float) else 0.0,
        )
        for value in parameters.values()
    ]
    return SimpleNamespace(values=values)


def asked(new: New, tilt: float) -> tuple[MavrosBridge, Callable[[Any], None]]:
    """Return a bridge engaged in GUIDED that knows a tilt, and what takes MAVROS's answer."""
    bridge = MavrosBridge(MavrosBridge.Config(autopilot="ardupilot"), new)
    response = engage(bridge, T0)
    (question,) = (call for call in response.calls if call.service.endswith("get_parameters"))
    assert question.service == "/mavros/param/get_parameters" and question.optional
    assert list(question.request.names) == ["GUID_OPTIONS", "ATC_ANGLE_BOOST"]
    state = new("mavros_msgs/msg/State")
    state.connected, state.mode, state.armed = True, "GUIDED", True
    deliver(bridge, "/mavros/state", state, T0)
    message = sound_message("nav_msgs/msg/Odometry", T0 + SECOND // 50)
    message.pose.pose.orientation.x = math.sin(0.5 * tilt)
    message.pose.pose.orientation.w = math.cos(0.5 * tilt)
    deliver(bridge, "/mavros/local_position/odom", message, T0 + SECOND // 50)
    assert question.receive is not None
    return bridge, question.receive


def thrust_of(bridge: MavrosBridge) -> float:
    now_ns = T0 + SECOND // 50
    outgoing = bridge.receive_command(command(now_ns, 0.4), now_ns=now_ns)
    return float(message_of(outgoing, "setpoint_raw/attitude").thrust)


@pytest.mark.parametrize("boost", [0, 1, 0.0, 1.0])
def test_compensates_the_reported_angle_boost(new: New, boost: float) -> None:
    bridge, answer = asked(new, tilt=0.6)
    plain = thrust_of(bridge)
    answer(parameters_response(options=8, boost=boost))
    assert thrust_of(bridge) == pytest.approx(plain * (math.cos(0.6) if boost else 1.0), rel=1e-6)
    assert bridge.take_warnings() == []


def test_thrust_that_would_be_a_climb_rate_is_not_sent(new: New) -> None:
    bridge, answer = asked(new, tilt=0.0)
    answer(parameters_response(options=0, boost=1))
    now_ns = T0 + SECOND // 50
    assert bridge.receive_command(command(now_ns), now_ns=now_ns) == []
    assert "GUID_OPTIONS is 0" in bridge.silence
    # With the parameter fixed, the bridge can be engaged and requests it again.
    again = bridge.engage(True, now_ns=now_ns)
    assert again.accepted and any(call.receive for call in again.calls)


def test_warns_of_parameters_that_mavros_does_not_report(new: New) -> None:
    bridge, answer = asked(new, tilt=0.6)
    plain = thrust_of(bridge)
    answer(parameters_response(options=8, boost=None))
    assert thrust_of(bridge) == plain
    (warning,) = bridge.take_warnings()
    assert "ATC_ANGLE_BOOST" in warning and "GUID_OPTIONS" not in warning
    # A reported value stays valid.
    answer(parameters_response(options=8, boost=1))
    answer(parameters_response(options=8, boost=None))
    assert thrust_of(bridge) == pytest.approx(plain * math.cos(0.6), rel=1e-6)


def test_px4_is_asked_for_nothing(new: New) -> None:
    bridge = MavrosBridge(MavrosBridge.Config(autopilot="px4"), new)
    assert not [c for c in engage(bridge, T0).calls if "param" in c.service]

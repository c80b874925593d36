# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Rules for all registered bridges."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import pytest
from fixtures import crazyflie, mavlink
from fixtures.betaflight import set_raw_rc
from fixtures.bridges import BRIDGES, HOVER, SECOND, T0, command, deliver_all, ready_to_fly

from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    OutgoingMessage,
    Response,
    SwitchedBridge,
)

New = Callable[[str], Any]


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_passes_a_fresh_command_and_reports_no_silence(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, T0)
    assert bridge.receive_command(command(T0 - SECOND // 100), now_ns=T0)
    assert (bridge.silence, bridge.commands, bridge.passed) == ("", 1, 1)


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (command(T0 - SECOND // 9), "0.111 s old"),
        (command(T0 + SECOND // 9), "-0.111 s old"),
        (command(T0, throttle=math.nan), "not finite"),
        (command(T0, w=(math.inf, 0.0, 0.0)), "not finite"),
        (command(T0, throttle=1.1), "outside"),
        (command(T0, throttle=-0.1), "outside"),
        (command(T0, w=(-101.0, 0.0, 0.0)), "101 rad/s"),
    ],
)
def test_drops_stale_and_invalid_commands(
    kind: type[Bridge], new: New, made: CommandSample, reason: str
) -> None:
    bridge = ready_to_fly(kind, T0)
    assert bridge.receive_command(made, now_ns=T0) == []
    assert reason in bridge.silence


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_sends_nothing_without_status(kind: type[Bridge], new: New) -> None:
    bridge = kind(kind.Config(), new)
    assert bridge.receive_command(command(T0), now_ns=T0) == []
    assert bridge.silence


@pytest.mark.parametrize(
    "kind", [each for each in BRIDGES.values() if not issubclass(each, SwitchedBridge)]
)
def test_silent_once_status_is_lost(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, T0)
    later = T0 + 4 * SECOND
    assert bridge.receive_command(command(later), now_ns=later) == []


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_every_topic_and_service_is_of_a_package_that_it_names(
    kind: type[Bridge], new: New
) -> None:
    bridge = kind(kind.Config(), new)
    own = {"geometry_msgs", "nav_msgs", "rcl_interfaces", "sensor_msgs", "std_srvs"}
    known = {*kind.packages, *own}
    named = [each.topic for each in bridge.subscriptions] + list(bridge.publications)
    types = [topic.type_name for topic in named] + [kind for _, kind in bridge.services]
    assert {type_name.split("/")[0] for type_name in types} <= known


def _line(answer: Response) -> bytes:
    return b"".join(each for each in answer.messages if isinstance(each, bytes))


def _message(answer: Response) -> Any:
    (outgoing,) = answer.messages
    assert isinstance(outgoing, OutgoingMessage)
    return outgoing.message


def _forced(request: Any) -> bool:
    """Whether it is MAV_CMD_COMPONENT_ARM_DISARM with the number that is not refused."""
    return (request.command, request.param1, request.param2) == (400, 0.0, 21196.0)


def _mavlink_stops(bridge: Bridge, answer: Response) -> bool:
    (request,) = mavlink.requests(_line(answer))
    return (request.command, request.parameters[:2]) == (400, (0.0, 21196.0))


def _crazyflie_stops(bridge: Bridge, answer: Response) -> bool:
    data = _line(answer)
    disarms = next(crazyflie.packets(data)) == (0xD0, b"\x01\x00")
    return disarms and crazyflie.setpoints(data) == [(0.0, 0.0, 0.0, 0)]


def _crazyswarm2_stops(bridge: Bridge, answer: Response) -> bool:
    (call,), twist = answer.calls, _message(answer)
    return not call.request.arm and twist.linear.z == twist.linear.x == twist.angular.z == 0.0


def _betaflight_stops(bridge: Bridge, answer: Response) -> bool:
    channels = set_raw_rc(bridge.exchange(b"", now_ns=T0 + SECOND // 10))[-1]
    return channels[2] == channels[4] == 1000  # throttle, and the channel that arms


# How the motors of a flying vehicle are stopped, in the words of each stack.
STOPS: dict[str, Callable[[Bridge, Response], bool]] = {
    "px4_bridge": lambda _, answer: _forced(_message(answer)),
    "mavlink_bridge": _mavlink_stops,
    "mavros_bridge": lambda _, answer: _forced(answer.calls[0].request),
    "aerostack2_bridge": lambda _, answer: (
        _message(answer).alert == -1 and not answer.calls[0].request.data
    ),
    "crazyswarm2_bridge": _crazyswarm2_stops,
    "crazyflie_bridge": _crazyflie_stops,
    "betaflight_bridge": _betaflight_stops,
}
CANNOT = {"rosflight_bridge": "RC transmitter", "rates_bridge": "tools of its own stack"}
FLIES_BY = {"betaflight_bridge": {"receiver": "bridge"}}


@pytest.mark.parametrize("name", BRIDGES)
def test_disarming_stops_the_motors_in_the_air_and_ends_the_engagement(
    name: str, new: New
) -> None:
    bridge = ready_to_fly(BRIDGES[name], T0, **FLIES_BY.get(name, {}))
    assert bridge.receive_command(command(T0, HOVER), now_ns=T0)
    answer = bridge.arm(False, now_ns=T0)
    if name in CANNOT:
        assert not answer.accepted and CANNOT[name] in answer.text
        return
    assert answer.accepted and STOPS[name](bridge, answer)
    assert bridge.handover == ("released", "released by disarming: call the service engage")
    later = T0 + SECOND // 50
    deliver_all(bridge, later)  # still armed and in the mode for setpoints, as far as it reports
    assert bridge.receive_command(command(later, HOVER), now_ns=later) == []


ARMS = [name for name in BRIDGES if name not in CANNOT]


@pytest.mark.parametrize("name", ARMS)
def test_answers_that_it_is_armed_only_when_the_stack_reports_it(name: str, new: New) -> None:
    bridge = ready_to_fly(BRIDGES[name], T0, **FLIES_BY.get(name, {}))
    assert bridge.arming_outcome(now_ns=T0) is None  # nothing was requested
    assert bridge.arm(True, now_ns=T0).accepted  # it is armed already
    outcome = bridge.arming_outcome(now_ns=T0)
    assert outcome is not None and outcome.accepted and outcome.text == "armed"
    # The stack goes on reporting that it is armed.
    assert bridge.arm(False, now_ns=T0).accepted
    for elapsed in range(30):
        now_ns = T0 + elapsed * SECOND // 10
        deliver_all(bridge, now_ns)
        assert bridge.arming_outcome(now_ns=now_ns) is None
    deliver_all(bridge, T0 + 3 * SECOND)
    outcome = bridge.arming_outcome(now_ns=T0 + 3 * SECOND)
    assert outcome is not None and not outcome.accepted
    assert "not reported that it is disarmed within 3 s" in outcome.text


@pytest.mark.parametrize("name", ARMS)
def test_arming_state_of_a_silent_stack_is_unknown(name: str, new: New) -> None:
    bridge = ready_to_fly(BRIDGES[name], T0, **FLIES_BY.get(name, {}))
    for wanted in (False, True):
        bridge.arm(wanted, now_ns=T0)
        outcome = bridge.arming_outcome(now_ns=T0 + 20 * SECOND)
        assert outcome is None or not outcome.accepted


@pytest.mark.parametrize("voltage", [65.535, 15_600.0])
@pytest.mark.parametrize("name", BRIDGES)
def test_a_battery_voltage_that_is_unknown_or_in_millivolts_changes_no_thrust(
    name: str, voltage: float, new: New
) -> None:
    kind = BRIDGES[name]
    thrust_map = dataclasses.replace(kind.Config().thrust_map, battery_voltage=15.0)
    bridge = kind(dataclasses.replace(kind.Config(), thrust_map=thrust_map), new)
    before = bridge.thrust.stack_throttle(HOVER)
    fields = ("voltage", "voltage_v", "battery_voltage")
    for each in bridge.subscriptions:
        message = new(each.topic.type_name)
        for field in fields:
            if hasattr(message, field):
                setattr(message, field, voltage)
                each.receive(message, T0)
    if name == "mavlink_bridge":
        speaker = mavlink.Speaker()
        status = speaker.say("sys_status", 0, 0, 0, 0, 65_535, -1, -1, 0, 0, 0, 0, 0, 0)
        bridge.exchange(speaker.heartbeat() + status, now_ns=T0)
    if name == "crazyflie_bridge":
        bridge.exchange(crazyflie.prepared() + crazyflie.logged(voltage=voltage), now_ns=T0)
    assert bridge.thrust.stack_throttle(HOVER) == before
    assert bridge.thrust.battery_scale == 1.0
